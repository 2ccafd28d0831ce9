// A MIDI keyboard: whenever its player pauses, what was played becomes a file.

const PAUSE = 2000, MOST_EVENTS = 60_000; // [ms] without a key down; of a phrase

async function askForKeyboards() {
  if (!navigator.requestMIDIAccess) throw new Refusal("This browser lets no page that comes from another machine hear MIDI keyboards. Open the studio on the machine on which it runs.");
  try {
    return await navigator.requestMIDIAccess();
  } catch {
    throw new Refusal("The browser does not let this page hear MIDI keyboards. Allow it MIDI devices in the settings of this site, beside the address, then try again.");
  }
}

/** `told` hears how many notes there are so far, and `phrase` is given the file [Uint8Array]. */
async function listenToKeyboards(told, phrase) {
  const access = await askForKeyboards(), held = new Set();
  let events = [], notes = 0, pause = null;
  function end() {
    if (notes) phrase(midiFile(events));
    [events, notes] = [[], 0];
  }
  function hear({ data, timeStamp }) {
    const [status, number, value] = data, kind = status & 0xf0;
    const strikes = kind === 0x90 && value > 0, lifts = kind === 0x80 || (kind === 0x90 && !value);
    if (!strikes && !lifts && !(kind === 0xb0 && number === 64)) return;
    if (!notes && !strikes) return; // silence comes before a phrase
    if (events.length < MOST_EVENTS) events.push([timeStamp, kind, number, value]);
    if (strikes) {
      held.add(number);
      told(++notes);
    } else if (lifts) held.delete(number);
    clearTimeout(pause);
    if (!held.size) pause = setTimeout(end, PAUSE);
  }
  const listen = () => access.inputs.forEach((input) => { input.onmidimessage = hear; });
  access.onstatechange = listen;
  listen();
  return () => {
    access.onstatechange = null;
    access.inputs.forEach((input) => { input.onmidimessage = null; });
    clearTimeout(pause);
    end(); // of a phrase under way
  };
}

/** A file of events [time in ms, kind, number, value]; a tick is a millisecond. */
function midiFile(events) {
  const parts = (length) => (length > 127 ? [...parts(length >> 7).map((byte) => byte | 0x80), length & 0x7f] : [length]);
  const track = [0, 0xff, 0x51, 3, 0x0f, 0x42, 0x40]; // a million microseconds a beat
  const inOrder = [...events].sort(([time], [other]) => time - other); // of several keyboards
  let before = inOrder[0][0];
  for (const [time, ...bytes] of inOrder) {
    const ticks = Math.round(time - before);
    track.push(...parts(ticks), ...bytes);
    before += ticks;
  }
  track.push(0, 0xff, 0x2f, 0);
  const long = (number) => [24, 16, 8, 0].map((bits) => (number >> bits) & 0xff), name = (text) => [...text].map((c) => c.charCodeAt(0));
  return Uint8Array.from([...name("MThd"), ...long(6), 0, 0, 0, 1, 0x03, 0xe8, ...name("MTrk"), ...long(track.length), ...track]);
}
