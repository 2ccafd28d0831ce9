// The sound of the keys: tones as the server makes them, struck and damped by Web Audio.

const VOLUME = 0.25; // of a note struck as hard as can be, at full volume of the page
const PAN = 0.45; // of the outermost keys; 1 is one side only
const UNDAMPED = 0.3; // [s] in which a key without a damper fades by 1/e, when it is lifted
const INAUDIBLE = 8; // times 1/e, which cannot be heard any more
const LONGEST = 10; // [s]: no tone is longer
const LOUDEST_SAMPLE = 32767, LOUDEST_VELOCITY = 127;

function createInstrument() {
  let context = null, master = null, strings = null, volume = 0.8, muted = false, settings = null, recording = null, loadedRows = 0;
  const tones = new Map(); // by name: { due, buffer, peak }; without a buffer until it has come
  const ringing = new Map(); // of a key: { source, gain, damped }, the last the time of the damper, or null

  const level = () => { if (master) master.gain.value = muted ? 0 : volume; };
  const nameOf = (key, velocity) => `${key + recording.lowest}/${Math.floor(velocity / settings.band)}`;
  async function fetchTone(name, due) {
    const tone = { due, buffer: null, peak: 0 };
    tones.set(name, tone);
    try {
      const answer = await fetch(`tones/${name}`);
      if (!answer.ok) throw new Error(`The studio answered ${answer.status}.`);
      const bytes = await answer.arrayBuffer(), samples = new Int16Array(bytes, 4);
      const buffer = new AudioBuffer({ length: samples.length, sampleRate: settings.rate });
      const channel = buffer.getChannelData(0);
      for (let i = 0; i < samples.length; i++) channel[i] = samples[i] / LOUDEST_SAMPLE;
      Object.assign(tone, { buffer, peak: new DataView(bytes).getFloat32(0, true) });
    } catch {
      tones.delete(name); // it is loaded again when a key is struck that needs it
    }
  }
  function damp(key, at) {
    const note = ringing.get(key);
    if (!note || note.damped !== null) return;
    note.damped = at;
    const fade = key + recording.lowest > settings.last_damper ? UNDAMPED : settings.damping;
    note.gain.gain.setTargetAtTime(0, at, fade);
    note.source.stop(at + INAUDIBLE * fade);
  }
  /** A key that bounces goes on: its damper has not fallen. */
  function undamp(key) {
    const note = ringing.get(key);
    if (!note || note.damped === null) return;
    note.gain.gain.cancelScheduledValues(note.damped);
    note.source.stop(note.damped + LONGEST);
    note.damped = null;
  }
  function strike(key, velocity, at) {
    const name = nameOf(key, velocity), tone = tones.get(name);
    if (!tone) fetchTone(name, Infinity); // nothing waits for it
    if (!tone?.buffer) return;
    damp(key, at);
    const source = new AudioBufferSourceNode(context, { buffer: tone.buffer });
    const gain = new GainNode(context, { gain: VOLUME * tone.peak * (velocity / LOUDEST_VELOCITY) ** settings.louder });
    const pan = new StereoPannerNode(context, { pan: PAN * ((2 * key + 1) / recording.keys - 1) });
    source.connect(gain).connect(pan).connect(strings);
    source.start(at);
    ringing.set(key, { source, gain, damped: null });
  }

  return {
    /** The audio clock, or null while nothing can sound. */
    get time() { return context?.state === "running" ? context.currentTime : null; },
    get isSuspended() { return context?.state !== "running"; },
    /** Starts the sound; to be called when the visitor does something, as browsers stay silent before. */
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
    /** Chooses the recording that is heard from now on. */
    setRecording(shown) {
      this.silence();
      [recording, settings, loadedRows] = [shown, shown.sound, 0];
      for (const tone of tones.values()) tone.due = Infinity; // for what was heard before
    },
    /** Loads the tones of all rows that have come. */
    loadTones() {
      for (; recording && loadedRows < recording.rows; loadedRows++) {
        for (let key = 0; key < recording.keys; key++) {
          const velocity = recording.velocity(loadedRows, key);
          if (!velocity) continue;
          const name = nameOf(key, velocity), tone = tones.get(name), due = loadedRows * recording.dt;
          if (tone) tone.due = Math.min(tone.due, due);
          else fetchTone(name, due);
        }
      }
    },
    /** Whether tones that are needed before `time` [s] have yet to come. */
    isMissing(time) {
      for (const { due, buffer } of tones.values()) if (!buffer && due < time) return true;
      return false;
    },
    /** Strikes and damps the keys of a row; `timeOf` gives the audio clock's time of one of the music [s]. */
    playRow(number, timeOf) {
      const down = recording.pedalDown(number), end = timeOf((number + 1) * recording.dt);
      for (let key = 0; key < recording.keys; key++) {
        const sounds = recording.sounds(number, key), velocity = recording.velocity(number, key);
        const at = timeOf(recording.changedAt(number, key));
        if (velocity) strike(key, velocity, at);
        if (sounds && !velocity) undamp(key);
        if (!sounds && !down) damp(key, velocity ? end : at);
      }
    },
    /** Ends all sound, also what has been scheduled. */
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
