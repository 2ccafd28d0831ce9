// The sound of the keys: tones as the server makes them, struck and damped by Web Audio.

const VOLUME = 0.25; // of a note struck as hard as can be, before what is set on the page

/** What strikes when: `row(number, at)` is told what happens at a time of the audio clock [s]. */
function createInstrument() {
  let context = null, master = null, volume = 0.8, muted = false, settings = null, live = null;
  const tones = new Map(), ringing = new Map(); // of a key: { source, gain, held }

  const level = () => { if (master) master.gain.value = muted ? 0 : volume; };
  function damp(key, at) {
    const note = ringing.get(key);
    if (!note) return;
    ringing.delete(key);
    const fade = key + live.lowest > settings.last_damper ? 0.3 : settings.damping;
    note.gain.gain.setTargetAtTime(0, at, fade);
    note.source.stop(at + 8 * fade);
  }
  function strike(key, velocity, at) {
    const tone = tones.get(`${key + live.lowest} ${Math.floor(velocity / settings.band)}`);
    if (!tone) return;
    damp(key, at);
    const source = new AudioBufferSourceNode(context, { buffer: tone.buffer });
    const gain = new GainNode(context, { gain: VOLUME * tone.peak * (velocity / 127) ** settings.louder });
    const pan = new StereoPannerNode(context, { pan: 0.45 * ((2 * key) / (live.keys - 1) - 1) });
    source.connect(gain).connect(pan).connect(master);
    source.start(at);
    ringing.set(key, { source, gain, held: true });
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
      }
      return context.resume();
    },
    begin(recording) {
      this.silence();
      [live, settings] = [recording, recording.sound];
      tones.clear();
    },
    /** A tone as `cadenza.studio.messages` has it. */
    learn(bytes) {
      const [pitch, band] = bytes, view = new DataView(bytes.buffer, bytes.byteOffset);
      const samples = new Int16Array(bytes.slice(8).buffer);
      const buffer = new AudioBuffer({ length: samples.length, sampleRate: settings.rate });
      const channel = buffer.getChannelData(0);
      for (let i = 0; i < samples.length; i++) channel[i] = samples[i] / 32767;
      tones.set(`${pitch} ${band}`, { buffer, peak: view.getFloat32(4, true) });
    },
    row(number, at) {
      const down = live.pedalDown(number);
      for (let key = 0; key < live.keys; key++) {
        const sounds = live.sounds(number, key), note = ringing.get(key);
        if (sounds > 1) strike(key, sounds, at);
        else if (!sounds && note) {
          note.held = false;
          if (!down) damp(key, at);
        }
      }
    },
    silence() {
      for (const { source } of ringing.values()) source.stop();
      ringing.clear();
    },
    set volume(value) { volume = value; level(); },
    set muted(value) { muted = value; level(); },
  };
}
