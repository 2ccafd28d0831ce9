// The controls that all players have in common: over the picture, and for the sound.

const minutes = (time) => `${Math.floor(time / 60)}:${(time % 60).toFixed(1).padStart(4, "0")}`;
const press = (button, pressed) => button.setAttribute("aria-pressed", pressed);
const isPressed = (button) => button.getAttribute("aria-pressed") === "true";

/** Buttons of which one is pressed: `chosen` is told the value of the attribute of the new one. */
function choice(attribute, chosen) {
  const buttons = [...document.querySelectorAll(`[${attribute}]`)];
  for (const button of buttons) {
    button.addEventListener("click", () => {
      chosen(button.getAttribute(attribute));
      for (const other of buttons) press(other, other === button);
    });
  }
}

/** A button that mutes, and a slider: `muted` and `volume` are told what was chosen. */
function loudness(muted, volume) {
  const mute = () => {
    const silent = !isPressed($("mute"));
    muted(silent);
    $("mute").classList.toggle("active", silent);
    press($("mute"), silent);
  };
  $("mute").addEventListener("click", mute);
  $("volume").addEventListener("input", () => volume(Number($("volume").value)));
  return mute;
}

/** Says how much of the window is needed around picture and score, as the header is as high as its words. */
function fitToWindow() {
  const card = $("performance"), heightOf = (id) => $(id)?.offsetHeight ?? 0, BELOW = 10; // [px]
  const measure = () => {
    const around = card.getBoundingClientRect().top + scrollY + card.offsetHeight - heightOf("stage") - heightOf("score") + BELOW;
    card.style.setProperty("--around", `${Math.ceil(around)}px`);
  };
  const observer = new ResizeObserver(() => requestAnimationFrame(measure));
  for (const part of document.querySelectorAll("header, .looks, .transport, .tools")) observer.observe(part);
}

/** A button that loops; returns whether it is pressed. */
function looping() {
  $("loop").addEventListener("click", () => press($("loop"), !isPressed($("loop"))));
  return () => isPressed($("loop"));
}

/** A button that fills the screen with the performance, where the browser can; returns what it does. */
function fullScreen() {
  const fill = () => {
    if (document.fullscreenEnabled) document.fullscreenElement ? document.exitFullscreen() : $("performance").requestFullscreen();
  };
  $("full").hidden = !document.fullscreenEnabled;
  $("full").addEventListener("click", fill);
  return fill;
}

/** Keys of the keyboard: `toggle`, `mute` and `fill` are run, `seek` is told where to go from `now()` [s]. */
function listenToKeys({ toggle, mute, fill, seek, now, end }) {
  const JUMP = 5, STEP = 0.5; // [s]
  const acts = {
    " ": toggle, k: toggle, m: mute, f: fill,
    j: () => seek(now() - JUMP), l: () => seek(now() + JUMP), home: () => seek(0), end: () => seek(end()),
    arrowleft: (event) => seek(now() - (event.shiftKey ? JUMP : STEP)), arrowright: (event) => seek(now() + (event.shiftKey ? JUMP : STEP)),
  };
  document.addEventListener("keydown", (event) => {
    const { target } = event, act = acts[event.key.toLowerCase()];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    if (target.matches("input:not(#scrub), select, textarea")) return;
    if (event.key === " " && target.matches("button, a, summary")) return;
    act(event);
    event.preventDefault();
  });
}

/** Of a button that plays and pauses. */
function showPlaying(playing) {
  $("play").classList.toggle("active", playing);
  const label = playing ? "Pause" : "Play";
  if ($("play").getAttribute("aria-label") !== label) $("play").setAttribute("aria-label", label);
}

const SLOWEST = 20; // [frames/s]
/**
 * Cameras, falling notes, and 3D or flat. `show(stage)` has the picture look as the buttons say.
 * `measure(moving)`, called every frame, has the flat view take over where 3D turns out slow over
 * the first second that anything moves.
 */
function createLooks() {
  let stage = null, measured = { frames: 0, spent: 0, last: 0 };
  function chooseFlat(flat, note = "") {
    const isFlat = stage.setFlat(flat);
    if (!flat && isFlat) note = "This browser cannot draw in 3D.";
    press($("solid"), !isFlat);
    $("flat-note").textContent = note;
    $("flat-note").hidden = !note;
  }
  choice("data-view", (name) => stage?.look(name));
  $("falling").addEventListener("click", () => {
    press($("falling"), !isPressed($("falling")));
    stage?.showNotes(isPressed($("falling")));
  });
  $("solid").addEventListener("click", () => {
    measured = null; // who chooses keeps what was chosen
    chooseFlat(!stage.flat);
  });
  return {
    show(shown) {
      const flat = stage?.flat ?? shown.flat; // as the picture before
      const note = flat && shown.flat ? "Flat view: this browser would draw 3D without a graphics card." : "";
      stage = shown;
      stage.showNotes(isPressed($("falling")));
      stage.look(document.querySelector('[data-view][aria-pressed="true"]').dataset.view);
      $("solid").hidden = !stage.solid;
      chooseFlat(flat, note);
    },
    measure(moving) {
      if (!measured || !moving || !stage || stage.flat) return;
      const at = performance.now();
      if (measured.last) {
        measured.frames++;
        measured.spent += Math.min(at - measured.last, 300); // a hidden page draws no frames
      }
      measured.last = at;
      if (measured.spent < 1000) return;
      if (measured.frames / (measured.spent / 1000) < SLOWEST) chooseFlat(true, "Flat view: 3D is slow here.");
      measured = null;
    },
  };
}
