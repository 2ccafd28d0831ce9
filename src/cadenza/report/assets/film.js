// The performance as a film: pictures of the stage at even times, encoded with the page's sound.

const FILM_RATE = 60, SLOW_RATE = 30; // pictures a second; without a graphics card, which takes half a second for each
const BITS_PER_PIXEL = 0.1; // of a picture; 12 Mbit/s at 1080p
const SOUND_BITS = 160_000, SOUND_RATE = 48_000; // a second; [Hz]
const TIMED = 10; // pictures, after which one can say how long the rest takes
const GROUP = 2; // [s] between two pictures that stand alone, to which players can jump
const TITLE = { seconds: 4, fade: 0.6, size: 0.045 }; // [s]; of the shorter side
const MARGIN_OF_SCORE = 0.02, BRACE = 400; // of its width, on either side; what is before a system, in units of a drawing
const LEAST_STAFF = 0.045; // of the shorter side; a system that is then wider than the film moves along with the cursor
const SCORE_STYLES = "text{font-family:Times,serif}.number,.mark{font-style:italic}.tempo,.fing{font-weight:bold}";

/** The page's own background, of a picture of this size [px]. */
function drawSky(context, width, height) {
  context.fillStyle = context.createRadialGradient(0, 0, 0, 0, 0, 1);
  ["--sky-light", "--sky-dark"].forEach((name, i) => context.fillStyle.addColorStop(i, css(name)));
  context.setTransform(1.2 * width, 0, 0, height, width / 2, 0);
  context.fillRect(-1, 0, 2, 1);
  context.resetTransform();
}

/** The title as the film begins, on glass as the page's labels; smaller where it is too long. */
function drawTitle(context, time, width, height) {
  const size = TITLE.size * Math.min(width, height), title = document.querySelector("h1").textContent;
  Object.assign(context, { globalAlpha: Math.min(Math.max((TITLE.seconds - time) / TITLE.fade, 0), 1), textBaseline: "middle" });
  context.font = `700 ${size}px ${getComputedStyle(document.body).fontFamily}`;
  const wide = Math.min(context.measureText(title).width, width - 4 * size);
  context.fillStyle = css("--glass");
  context.beginPath();
  context.roundRect(size, size, wide + 1.6 * size, 2 * size, 0.5 * size);
  context.fill();
  context.fillStyle = css("--ink");
  context.fillText(title, 1.8 * size, 2.05 * size, wide);
  context.globalAlpha = 1;
}

/** The system of the score that is played, below the stage of a film of this size [px]. */
function createScoreBand(engraving, data, width, filmHeight) {
  const element = make("div"), systems = drawSystems(element, engraving), notes = drawnNotes(element, engraving, data.lowest), ink = css("--ink");
  placeAnchors(systems, notes);
  const longest = longestOf(notes), margin = MARGIN_OF_SCORE * width, room = width - 2 * margin;
  const scale = Math.max(room / (BRACE + Math.max(...systems.map((each) => each.width))), (LEAST_STAFF * Math.min(width, filmHeight)) / STAFF);
  const height = 2 * Math.ceil((scale * Math.max(...systems.map((each) => each.height)) + margin) / 2), image = new Image();
  let shown = null;
  async function turnTo(system) {
    const { width: wide, height: high } = shown = system, { svg } = engraving.systems[systems.indexOf(system)];
    const size = `width="${scale * (BRACE + wide)}" height="${scale * high}" viewBox="${-BRACE} 0 ${BRACE + wide} ${high}"`;
    const text = `<svg xmlns="http://www.w3.org/2000/svg" ${size} fill="${ink}" stroke="${ink}" stroke-width="0"><style>${SCORE_STYLES}</style><defs>${engraving.glyphs}</defs>${svg}</svg>`;
    image.src = `data:image/svg+xml,${encodeURIComponent(text)}`;
    await image.decode();
  }
  return {
    height,
    async draw(context, time, top) {
      const next = systems.findLast(({ begin }) => begin <= time + AHEAD) ?? systems[0];
      if (next !== shown) await turnTo(next);
      context.fillStyle = css("--card");
      context.fillRect(0, top, width, height);
      const before = scale * BRACE, cursor = scale * placeAt(next.anchors, time);
      const left = margin + before - Math.max(Math.min(cursor - BEFORE_THE_CURSOR * width, before + scale * next.width - room), 0);
      const { row } = rowAt(time, data.dt, data.steps), y = top + (height - scale * next.height) / 2;
      within(notes, longest, time, time + 1e-6, ({ key, parts }) => {
        context.fillStyle = `${css(data.states[row * data.keys + key] === HIT ? "--hit" : "--missed")}70`;
        for (const spot of parts.filter((part) => next.drawing.contains(part)).map((part) => part.querySelector(".spot"))) {
          context.beginPath();
          context.arc(left + scale * spot.getAttribute("cx"), y + scale * spot.getAttribute("cy"), scale * SPOT, 0, 2 * Math.PI);
          context.fill();
        }
      });
      context.drawImage(image, left - before, y);
      context.fillStyle = css("--accent");
      context.fillRect(left + cursor - 1, y, 2, scale * next.height);
    },
  };
}

/**
 * A film that is to be drawn: `draw(time)` draws what is to be seen at a time [s] of it on `canvas`.
 *
 * Of what is asked for: its size [px], a `camera`, the `score` below, from `start` to `end` [s]
 * of the performance, whether it is `silent`, and whether it is drawn as it plays (`live`): flat
 * without a graphics card, to keep up.
 */
async function createFilm(data, engraving, { width, height, camera, falling = true, score, start = 0, end = Infinity, silent, live }) {
  const stage = createStage(make("canvas", [], { className: "view" }), data, VERDICTS.map((name) => css("--" + name)));
  const canvas = make("canvas", [], { width, height }), context = canvas.getContext("2d", { alpha: false, willReadFrequently: !stage.byCard });
  const band = score && engraving ? createScoreBand(engraving, data, width, height) : null, tall = height - (band?.height ?? 0);
  const rate = stage.byCard ? FILM_RATE : SLOW_RATE, length = data.steps * data.dt;
  stage.setFlat(live && !stage.byCard);
  stage.fit(width, tall);
  stage.move(start);
  stage.showNotes(falling);
  stage.look(camera);
  let drawn = 0;
  return {
    canvas, rate,
    bitrate: Math.round(BITS_PER_PIXEL * width * height * rate),
    count: Math.max(Math.round((Math.min(end, length) - start) * rate), 1),
    /** The page's, which rings on after the last picture. */
    sound: silent ? null : await new OfflineAudioContext(2, 1, SOUND_RATE).decodeAudioData(fromBase64(document.querySelector("script.sound").textContent).buffer),
    async draw(time) {
      stage.move(start + time);
      stage.draw(time - drawn);
      drawn = time;
      drawSky(context, width, tall);
      context.drawImage(stage.picture, 0, 0, width, tall);
      await band?.draw(context, start + time, tall);
      drawTitle(context, time, width, height);
    },
    /** Lets go of what draws it. */
    close: stage.end,
  };
}

const channel = new MessageChannel();
/** Lets the page do what else it has to, also while it is hidden. */
const breathe = () => new Promise((resolve) => {
  channel.port1.onmessage = resolve;
  channel.port2.postMessage(null);
});

/** Encodes a film as fast as it is drawn; returns a file, null if `progress(done, total)` of pictures stops it. */
async function encodeFilm({ canvas, rate, count, sound, bitrate, draw }, progress) {
  const { AudioBufferSource, BufferTarget, CanvasSource, Mp4OutputFormat, Output, getFirstEncodableAudioCodec, getFirstEncodableVideoCodec } = Mediabunny;
  const { width, height } = canvas, audio = { numberOfChannels: sound?.numberOfChannels, sampleRate: SOUND_RATE, bitrate: SOUND_BITS };
  // What plays everywhere, or else what plays in browsers
  const codec = await getFirstEncodableVideoCodec(["avc", "vp9", "av1"], { width, height, bitrate });
  if (!codec) throw Error(`this browser cannot encode films of ${width} x ${height} pixels: choose a smaller size`);
  const output = new Output({ format: new Mp4OutputFormat(), target: new BufferTarget() });
  const pictures = new CanvasSource(canvas, { codec, bitrate, keyFrameInterval: GROUP });
  output.addVideoTrack(pictures, { frameRate: rate });
  const heard = sound && new AudioBufferSource({ codec: await getFirstEncodableAudioCodec(["aac", "opus"], audio), bitrate: SOUND_BITS });
  if (heard) output.addAudioTrack(heard);
  await output.start();
  await heard?.add(sound);
  for (let i = 0; i < count; i++) {
    if (!(await progress(i, count))) {
      await output.cancel();
      return null;
    }
    await draw(i / rate);
    await pictures.add(i / rate, 1 / rate);
    await breathe();
  }
  await output.finalize();
  progress(count, count);
  return new Blob([output.target.buffer], { type: "video/mp4" });
}

/** The same of a film that is recorded while it plays, where a browser cannot encode single pictures. */
async function recordFilm({ canvas, rate, count, sound, bitrate, draw }, progress) {
  const mimeType = ["video/mp4", "video/webm"].find((each) => globalThis.MediaRecorder?.isTypeSupported(each));
  if (!mimeType) throw Error("this browser cannot encode films: open the page in a newer Chrome, Edge, Firefox or Safari");
  const clock = new AudioContext(), heard = clock.createMediaStreamDestination(), source = new AudioBufferSourceNode(clock, { buffer: sound });
  source.connect(heard);
  const recorder = new MediaRecorder(new MediaStream([...canvas.captureStream(rate).getTracks(), ...heard.stream.getTracks()]), { mimeType, videoBitsPerSecond: bitrate });
  const pieces = [], stopped = new Promise((resolve) => recorder.addEventListener("stop", resolve));
  recorder.addEventListener("dataavailable", ({ data }) => pieces.push(data));
  await draw(0);
  await clock.resume();
  recorder.start();
  source.start();
  const began = clock.currentTime;
  let isMaking = true;
  for (let at = 0; at < count && isMaking; at = Math.round((clock.currentTime - began) * rate)) {
    isMaking = progress(at, count);
    await draw(at / rate);
    await new Promise((resolve) => setTimeout(resolve, 1000 / rate));
  }
  recorder.stop();
  await stopped;
  await clock.close();
  return isMaking ? new Blob(pieces, { type: mimeType }) : null;
}

/** The dialog that asks how a film is to be, and makes it. */
function offerFilm(data, engraving) {
  const dialog = $("film-dialog"), [encode, how] = "VideoEncoder" in globalThis ? [encodeFilm, ""] : [recordFilm, ", recorded as it plays"];
  let began = null; // [ms] while one is made
  const stop = () => { began = null; }, say = (text) => { $("film-status").textContent = text; };
  function progress(done, total) {
    if (began === null) return false;
    Object.assign($("film-done"), { max: total, value: done });
    const left = ((performance.now() - began) / 1000 / Math.max(done, 1)) * (total - done);
    say(`${Math.floor((100 * done) / total)} %${done >= TIMED ? `, ${minutes(left).split(".")[0]} left` : ""}${how}`);
    return true;
  }
  const show = (making) => { $("film-make").disabled = !($("film-stop").hidden = $("film-done").hidden = !making); };
  $("film").addEventListener("click", () => dialog.showModal());
  dialog.addEventListener("close", stop);
  $("film-stop").addEventListener("click", stop);
  $("film-make").addEventListener("click", async () => {
    const [width, height] = $("film-size").value.split(" ").map(Number);
    let film;
    began = performance.now();
    show(true);
    try {
      film = await createFilm(data, engraving, { width, height, camera: $("film-camera").value, falling: $("film-falling").checked, score: $("film-score")?.checked, live: encode === recordFilm });
      const file = await encode(film, progress);
      if (!file) return say("Stopped.");
      const download = `${document.querySelector("h1").textContent}.${file.type.slice("video/".length)}`;
      make("a", [], { href: URL.createObjectURL(file), download }).click();
      say(`Saved: ${(file.size / 1e6).toFixed(1)} MB.`);
    } catch (error) {
      say(`No film: ${error.message}.`);
    } finally {
      film?.close();
      show(false);
    }
  });
  if (location.hash === "#film") dialog.showModal();
}

/** Makes the film that `cadenza film` has asked for in the address of the page, and sends it there; time counts from the second picture on, as shaders are made for the first. */
async function sendFilm(data, engraving, asked) {
  const send = (name, body) => fetch(name, { method: "POST", body });
  try {
    const film = await createFilm(data, engraving, asked);
    await send("film", await encodeFilm(film, (done, total) => done === 0 || send(`progress/${done}/${total}`)));
  } catch (error) {
    await send("error", error.message);
  }
}
