// The sound of the keys: tones as the server makes them, struck and damped by Web Audio.

const VOLUME = 0.25; // of a note struck as hard as can be, before what is set on the page

function createInstrument() {
  let context = null, master = null, strings = null, volume = 0.8, muted = false, settings = null, live = null, asked = 0;
  const tones = new Map(); // by name: { due, buffer, peak }; without a buffer until it has come
  const ringing = new Map(); // of a key: { source, gain }

  const level = () => { if (master) master.gain.value = muted ? 0 : volume; };
  const nameOf = (key, velocity) => `${key + live.lowest}/${Math.floor(velocity / settings.band)}`;
  async function fetchTone(name, due) {
    const tone = { due, buffer: null, peak: 0 };
    tones.set(name, tone);
    try {
      const answer = await fetch(`tones/${name}`);
      if (!answer.ok) throw new Error(`The studio answered ${answer.status}.`);
      const bytes = await answer.arrayBuffer(), samples = new Int16Array(bytes, 4);
      const buffer = new AudioBuffer({ length: samples.length, sampleRate: settings.rate });
      const channel = buffer.getChannelData(0);
      for (let i = 0; i < samples.length; i++) channel[i] = samples[i] / 32767;
      Object.assign(tone, { buffer, peak: new DataView(bytes).getFloat32(0, true) });
    } catch {
      tones.delete(name); // it is asked for again when a key is struck that needs it
    }
  }
  function damp(key, at) {
    const note = ringing.get(key);
    if (!note) return;
    ringing.delete(key);
    const fade = key + live.lowest > settings.last_damper ? 0.3 : settings.damping;
    note.gain.gain.setTargetAtTime(0, at, fade);
    note.source.stop(at + 8 * fade);
  }
  function strike(key, velocity, at) {
    const name = nameOf(key, velocity), tone = tones.get(name);
    if (!tone) fetchTone(name, Infinity); // nothing waits for it
    if (!tone?.buffer) return;
    damp(key, at);
    const source = new AudioBufferSourceNode(context, { buffer: tone.buffer });
    const gain = new GainNode(context, { gain: VOLUME * tone.peak * (velocity / 127) ** settings.louder });
    const pan = new StereoPannerNode(context, { pan: 0.45 * ((2 * key + 1) / live.keys - 1) });
    source.connect(gain).connect(pan).connect(strings);
    source.start(at);
    ringing.set(key, { source, gain });
  }

  return {
    /** The audio clock, or null while nothing can sound. */
    get time() { return context?.state === "running" ? context.currentTime : null; },
    get waits() { return context?.state !== "running"; },
    /** To be called when the visitor does something: before, browsers stay silent. */
    wake() {
      if (!context) {
        context = new AudioContext({ latencyHint: "interactive" });
        const limiter = new DynamicsCompressorNode(context, { threshold: -6, ratio: 12, release: 0.15 });
        master = new GainNode(context);
        master.connect(limiter).connect(context.destination);
        level();
        this.silence();
      }
      return context.resume();
    },
    /** What is heard from now on. */
    begin(recording) {
      this.silence();
      [live, settings, asked] = [recording, recording.sound, 0];
      for (const tone of tones.values()) tone.due = Infinity; // for what was heard before
    },
    /** Asks for the tones of all rows that have come. */
    prepare() {
      for (; live && asked < live.rows; asked++) {
        for (let key = 0; key < live.keys; key++) {
          const velocity = live.sounds(asked, key);
          if (velocity <= 1) continue;
          const name = nameOf(key, velocity), tone = tones.get(name), due = asked * live.dt;
          if (tone) tone.due = Math.min(tone.due, due);
          else fetchTone(name, due);
        }
      }
    },
    /** Whether tones that are needed before `time` [s] have yet to come. */
    lacks(time) {
      for (const { due, buffer } of tones.values()) if (!buffer && due < time) return true;
      return false;
    },
    /** What strikes and what is damped in a row, at a time of the audio clock [s]. */
    row(number, at) {
      const down = live.pedalDown(number);
      for (let key = 0; key < live.keys; key++) {
        const sounds = live.sounds(number, key);
        if (sounds > 1) strike(key, sounds, at);
        else if (!sounds && !down) damp(key, at);
      }
    },
    /** Also what has been scheduled. */
    silence() {
      ringing.clear();
      if (!context) return;
      strings?.disconnect();
      strings = new GainNode(context);
      strings.connect(master);
    },
    set volume(value) { volume = value; level(); },
    set muted(value) { muted = value; level(); },
  };
}
