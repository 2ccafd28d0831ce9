// A MIDI keyboard: whenever its player pauses, what was played becomes a file.

const PAUSE = 2000; // [ms] without a key down that end a phrase
const MAX_EVENTS = 60_000; // of a phrase
const NOTE_OFF = 0x80, NOTE_ON = 0x90, CONTROL_CHANGE = 0xb0, SUSTAIN_PEDAL = 64; // of MIDI

async function askForKeyboards() {
  if (!navigator.requestMIDIAccess) throw new Refusal("This browser lets no page that comes from another machine hear MIDI keyboards. Open the studio on the machine on which it runs.");
  try {
    return await navigator.requestMIDIAccess();
  } catch {
    throw new Refusal("The browser does not let this page hear MIDI keyboards. Allow it MIDI devices in the settings of this site, beside the address, then try again.");
  }
}

/** Calls `onCount` with the number of notes so far, and `onPhrase` with a MIDI file [Uint8Array]. */
async function listenToKeyboards(onCount, onPhrase) {
  const access = await askForKeyboards(), held = new Set();
  let events = [], notes = 0, pause = null;
  function end() {
    if (notes) onPhrase(midiFile(events));
    [events, notes] = [[], 0];
  }
  function receive({ data, timeStamp }) {
    const [status, number, value] = data, kind = status & 0xf0;
    const strikes = kind === NOTE_ON && value > 0, lifts = kind === NOTE_OFF || (kind === NOTE_ON && !value);
    if (!strikes && !lifts && !(kind === CONTROL_CHANGE && number === SUSTAIN_PEDAL)) return;
    if (!notes && !strikes) return; // silence comes before a phrase
    if (events.length < MAX_EVENTS) events.push([timeStamp, kind, number, value]);
    if (strikes) {
      held.add(number);
      onCount(++notes);
    } else if (lifts) held.delete(number);
    clearTimeout(pause);
    if (!held.size) pause = setTimeout(end, PAUSE);
  }
  const listen = () => access.inputs.forEach((input) => { input.onmidimessage = receive; });
  access.onstatechange = listen;
  listen();
  return () => {
    access.onstatechange = null;
    access.inputs.forEach((input) => { input.onmidimessage = null; });
    clearTimeout(pause);
    end(); // of a phrase under way
  };
}

/** Returns a MIDI file of events [time in ms, kind, number, value]; a tick is a millisecond. */
function midiFile(events) {
  const variableLength = (length) => (length > 127 ? [...variableLength(length >> 7).map((byte) => byte | 0x80), length & 0x7f] : [length]);
  const track = [0, 0xff, 0x51, 3, 0x0f, 0x42, 0x40]; // a million microseconds a beat
  const inOrder = [...events].sort(([time], [other]) => time - other); // of several keyboards
  let before = inOrder[0][0];
  for (const [time, ...bytes] of inOrder) {
    const ticks = Math.round(time - before);
    track.push(...variableLength(ticks), ...bytes);
    before += ticks;
  }
  track.push(0, 0xff, 0x2f, 0);
  const long = (number) => [24, 16, 8, 0].map((bits) => (number >> bits) & 0xff), name = (text) => [...text].map((c) => c.charCodeAt(0));
  return Uint8Array.from([...name("MThd"), ...long(6), 0, 0, 0, 1, 0x03, 0xe8, ...name("MTrk"), ...long(track.length), ...track]);
}
