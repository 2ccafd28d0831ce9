// The performance as a film: pictures of the stage at even times, encoded with the page's sound.

const FILM_RATE = 60, SLOW_RATE = 30; // pictures a second; without a graphics card, which takes a second for each
const BITS_PER_PIXEL = 0.1; // of a picture; 12 Mbit/s at 1080p
const SOUND_BITS = 160_000, SOUND_RATE = 48_000; // a second; [Hz]
const RINGING = 1; // [s] that the last notes of the whole may ring on
const TITLE = { seconds: 4, fade: 0.6, large: 0.05, small: 0.028, margin: 0.045 }; // [s]; of the shorter side
const HALO = 0.2; // of the size of letters, around them: behind them it may be dark
const MARGIN_OF_SCORE = 0.02; // of its width, on either side
const GROUP = 2; // [s] between two pictures that stand alone, to which players can jump

/** The page's own background, of a picture of this size [px]. */
function drawSky(context, width, height) {
  const gradient = context.createRadialGradient(0, 0, 0, 0, 0, 1);
  gradient.addColorStop(0, css("--sky-light"));
  gradient.addColorStop(1, css("--sky-dark"));
  context.save();
  context.translate(width / 2, 0);
  context.scale(1.2 * width, height);
  context.fillStyle = gradient;
  context.fillRect(-1, 0, 2, 1);
  context.restore();
}

/** Title and player, which come and go as the film begins; smaller where they are too long. */
function drawTitle(context, lines, time, width, height) {
  const opacity = Math.min(1, time / TITLE.fade, (TITLE.seconds - time) / TITLE.fade);
  if (opacity <= 0) return;
  const side = Math.min(width, height), margin = TITLE.margin * side;
  Object.assign(context, { globalAlpha: opacity, fillStyle: css("--ink"), strokeStyle: css("--sky-light"), lineJoin: "round", textBaseline: "top" });
  lines.reduce((top, line, i) => {
    const size = side * (i ? TITLE.small : TITLE.large);
    context.lineWidth = HALO * size;
    context.font = `${i ? 400 : 700} ${size}px ${getComputedStyle(document.body).fontFamily}`;
    context.strokeText(line, margin, top, width - 2 * margin);
    context.fillText(line, margin, top, width - 2 * margin);
    return top + 1.3 * size;
  }, margin);
  context.globalAlpha = 1;
}

/** The system of the score that is played, as wide as the film [px], below the stage. */
function createScoreBand(engraving, data, width) {
  const element = make("div"), systems = drawSystems(element, engraving), notes = drawnNotes(element, engraving, data.lowest);
  placeAnchors(systems, notes);
  const longest = longestOf(notes), margin = MARGIN_OF_SCORE * width, scale = (width - 2 * margin) / Math.max(...systems.map((each) => each.width));
  const height = 2 * Math.ceil((scale * Math.max(...systems.map((each) => each.height)) + margin) / 2);
  const styles = "text{font-family:Times,serif}.number,.mark{font-style:italic}.tempo,.fing{font-weight:bold}";
  const canvas = make("canvas", [], { width, height });
  let shown = null;
  async function turnTo(system) {
    const { width: wide, height: high } = shown = system, size = `width="${scale * wide}" height="${scale * high}" viewBox="0 0 ${wide} ${high}"`;
    const text = `<svg xmlns="http://www.w3.org/2000/svg" ${size} fill="${css("--ink")}" stroke="${css("--ink")}" stroke-width="0"><style>${styles}</style><defs>${engraving.glyphs}</defs>${engraving.systems[systems.indexOf(system)].svg}</svg>`;
    const image = new Image(), context = canvas.getContext("2d");
    image.src = URL.createObjectURL(new Blob([text], { type: "image/svg+xml" }));
    await image.decode();
    context.clearRect(0, 0, width, height);
    context.drawImage(image, margin, (height - scale * high) / 2);
    URL.revokeObjectURL(image.src);
  }
  return {
    height,
    async draw(context, time, top) {
      const next = systems.findLast(({ begin }) => begin <= time + AHEAD) ?? systems[0];
      if (next !== shown) await turnTo(next);
      context.fillStyle = css("--card");
      context.fillRect(0, top, width, height);
      const { row } = rowAt(time, data.dt, data.steps), x = (units) => margin + scale * units, y = top + (height - scale * next.height) / 2;
      within(notes, longest, time, time + 1e-6, ({ key, parts }) => {
        for (const part of parts.filter((each) => next.drawing.contains(each))) {
          const spot = part.querySelector(".spot"), state = data.states[row * data.keys + key];
          context.fillStyle = `${css(state === HIT ? "--hit" : "--missed")}70`;
          context.beginPath();
          context.arc(x(spot.getAttribute("cx")), y + scale * spot.getAttribute("cy"), scale * SPOT, 0, 2 * Math.PI);
          context.fill();
        }
      });
      context.drawImage(canvas, 0, top);
      context.fillStyle = css("--accent");
      context.fillRect(x(placeAt(next.anchors, time)) - 1, y, 2, scale * next.height);
    },
  };
}

/** Lets the page do what else it has to, also while it is hidden. */
const breathe = () => new Promise((resolve) => {
  const { port1, port2 } = new MessageChannel();
  port1.onmessage = () => { port1.close(); resolve(); };
  port2.postMessage(null);
});

/** The page's sound between two times [s], of which `part(from, to)` is a part. */
async function decodedSound() {
  const bytes = fromBase64(document.querySelector("script.sound").textContent);
  const sound = await new OfflineAudioContext(2, 1, SOUND_RATE).decodeAudioData(bytes.buffer);
  return {
    seconds: sound.duration,
    part(from, to) {
      const first = Math.round(from * SOUND_RATE), length = Math.max(Math.round(to * SOUND_RATE) - first, 1);
      const part = new AudioBuffer({ numberOfChannels: 2, length, sampleRate: SOUND_RATE });
      for (const channel of [0, 1]) {
        part.copyToChannel(sound.getChannelData(Math.min(channel, sound.numberOfChannels - 1)).subarray(first, first + length), channel);
      }
      return part;
    },
  };
}

/**
 * A film of a performance that is to be drawn: `draw(time, seconds)` draws the picture at a time [s],
 * some seconds after the one before, on `canvas`; from `start` to `end` [s].
 *
 * `look` has its size [px], `view`, whether notes fall (`falling`) and the score is below (`score`);
 * `start` and `end`, to the end of the performance without; and whether it has sound.
 */
async function createFilm(data, engraving, lines, look) {
  const stage = createStage(make("canvas", [], { className: "view" }), data, VERDICTS.map((name) => css("--" + name)));
  const { width, height, view, falling, start = 0 } = look, rate = stage.byCard ? FILM_RATE : SLOW_RATE;
  const sound = look.silent ? null : await decodedSound(), length = data.steps * data.dt;
  const end = Math.min(look.end ?? length + RINGING, sound && look.end === undefined ? Math.max(sound.seconds, length) : length);
  const canvas = make("canvas", [], { width, height }), context = canvas.getContext("2d", { alpha: false });
  const band = look.score && engraving ? createScoreBand(engraving, data, width) : null, tall = height - (band?.height ?? 0);
  stage.setFlat(false);
  stage.fit(width, tall);
  stage.move(start);
  stage.showNotes(falling);
  stage.look(view);
  return {
    canvas, start, end, rate, sound, width, height,
    bitrate: Math.round(BITS_PER_PIXEL * width * height * rate),
    count: Math.max(Math.round((end - start) * rate), 1),
    async draw(time, seconds) {
      stage.move(time);
      stage.draw(seconds);
      drawSky(context, width, tall);
      context.drawImage(stage.picture, 0, 0, width, tall);
      await band?.draw(context, Math.min(time, length), tall);
      drawTitle(context, lines, time - start, width, tall);
    },
    /** Lets go of what draws it. */
    close: stage.end,
  };
}

/**
 * Encodes a film picture by picture, and writes it to a `target` of Mediabunny as an MP4.
 *
 * `progress(done, total)` is told about pictures, and returns whether to go on; returns whether it is whole.
 */
async function encodeFilm({ canvas, start, rate, count, sound, width, height, bitrate, draw }, target, progress) {
  const { AudioBufferSource, CanvasSource, Mp4OutputFormat, Output, getFirstEncodableAudioCodec, getFirstEncodableVideoCodec } = Mediabunny;
  // What plays everywhere, or else what plays in browsers
  const codec = await getFirstEncodableVideoCodec(["avc", "vp9", "av1"], { width, height, bitrate });
  if (!codec) throw Error(`this browser cannot encode films of ${width} x ${height} pixels: choose a smaller size`);
  const output = new Output({ format: new Mp4OutputFormat(), target });
  const pictures = new CanvasSource(canvas, { codec, bitrate, keyFrameInterval: GROUP });
  output.addVideoTrack(pictures, { frameRate: rate });
  const heard = sound && new AudioBufferSource({ codec: await getFirstEncodableAudioCodec(["aac", "opus"], { numberOfChannels: 2, sampleRate: SOUND_RATE, bitrate: SOUND_BITS }), bitrate: SOUND_BITS });
  if (heard) output.addAudioTrack(heard);
  await output.start();
  for (let i = 0; i < count; i++) {
    if (!progress(i, count)) {
      await output.cancel();
      return false;
    }
    const time = start + i / rate;
    if (heard && i % rate === 0) await heard.add(sound.part(time, Math.min(time + 1, start + count / rate)));
    await draw(time, 1 / rate);
    await pictures.add(i / rate, 1 / rate);
    await breathe();
  }
  await output.finalize();
  progress(count, count);
  return true;
}

/** Records a film while it plays, where a browser cannot encode single pictures; returns a file, null if `progress` stops it. */
async function recordFilm({ canvas, start, end, rate, count, sound, bitrate, draw }, progress) {
  const type = ["video/mp4", "video/webm"].find((each) => globalThis.MediaRecorder?.isTypeSupported(each));
  if (!type) throw Error("this browser cannot encode films: open the page in a newer Chrome, Edge, Firefox or Safari");
  const clock = new AudioContext(), heard = clock.createMediaStreamDestination(), source = clock.createBufferSource();
  source.buffer = sound.part(start, end);
  source.connect(heard);
  const tracks = [canvas.captureStream(rate), heard.stream].flatMap((stream) => stream.getTracks());
  const recorder = new MediaRecorder(new MediaStream(tracks), { mimeType: type, videoBitsPerSecond: bitrate }), pieces = [];
  recorder.addEventListener("dataavailable", ({ data }) => pieces.push(data));
  const stopped = new Promise((resolve) => recorder.addEventListener("stop", resolve));
  await draw(start, 0);
  await clock.resume();
  recorder.start();
  source.start();
  const began = clock.currentTime, now = () => Math.min(start + clock.currentTime - began, end);
  let time = start, isMaking = true;
  while (time < end && (isMaking = progress(Math.round((time - start) * rate), count))) {
    const next = now();
    await draw(next, next - time);
    time = next;
    await new Promise((resolve) => setTimeout(resolve, 1000 / rate / 2));
  }
  recorder.stop();
  await stopped;
  await clock.close();
  return isMaking ? new Blob(pieces, { type }) : null;
}

/** The dialog that asks how a film is to be, and makes it. */
function offerFilm(data, engraving, lines) {
  const dialog = $("film-dialog"), say = (text) => { $("film-status").textContent = text; };
  let isMaking = false;
  const stop = () => { isMaking = false; };
  $("film").addEventListener("click", () => dialog.showModal());
  dialog.addEventListener("close", stop);
  $("film-stop").addEventListener("click", stop);
  $("film-make").addEventListener("click", async () => {
    const [width, height] = $("film-size").value.split(" ").map(Number);
    const look = { width, height, view: $("film-camera").value, falling: $("film-falling").checked, score: $("film-score")?.checked };
    const began = performance.now(), canEncode = "VideoEncoder" in globalThis;
    const progress = (done, total) => {
      Object.assign($("film-done"), { max: total, value: done });
      const left = ((performance.now() - began) / 1000 / Math.max(done, 1)) * (total - done);
      const how = canEncode ? "" : ", recorded as it plays";
      say(`${Math.floor((100 * done) / total)} %${done > FILM_RATE ? `, ${minutes(left).split(".")[0]} left` : ""}${how}`);
      return isMaking;
    };
    show(true);
    let film;
    try {
      film = await createFilm(data, engraving, lines, look);
      let file;
      if (canEncode) {
        const target = new Mediabunny.BufferTarget();
        file = (await encodeFilm(film, target, progress)) && new Blob([target.buffer], { type: "video/mp4" });
      } else file = await recordFilm(film, progress);
      if (!file) return say("Stopped.");
      const name = `${document.querySelector("h1").textContent}.${file.type.slice("video/".length)}`;
      make("a", "", { href: URL.createObjectURL(file), download: name }).click();
      say(`Saved: ${(file.size / 1e6).toFixed(1)} MB.`);
    } catch (error) {
      say(`No film: ${error.message}.`);
    } finally {
      film?.close();
      show(false);
    }
  });
  /** Shows whether a film is being made. */
  function show(making) {
    isMaking = making;
    $("film-make").disabled = making;
    $("film-stop").hidden = $("film-done").hidden = !making;
  }
  if (location.hash === "#film") dialog.showModal();
}

/** Makes the film that `cadenza film` has asked for in the address of the page, and sends it there in pieces. */
async function sendFilm(data, engraving, lines, asked) {
  const send = (name, body) => fetch(name, { method: "POST", body }), PICTURES = 4; // between two reports
  const writable = new WritableStream({ write: ({ data: bytes, position }) => send(`film/${position}`, bytes) });
  try {
    const film = await createFilm(data, engraving, lines, asked);
    await encodeFilm(film, new Mediabunny.StreamTarget(writable, { chunked: true }), (done, total) => {
      if (done % PICTURES === 0) send(`progress/${done}/${total}`);
      return true;
    });
    await send("end");
  } catch (error) {
    await send("error", error.message);
  }
}
