// Buttons that move the robot while they are held. The page repeats a held one; without repeats hil jog stops.
"use strict";
const EVERY_MS = 50;
const OF_BODY = { w: "ahead", s: "back", a: "to the left", d: "to the right", q: "turn left", e: "turn right" };
const OF_WHEEL = { w: "forward", s: "back" };
const OF_AXIS = { w: "counter-clockwise", s: "clockwise" };
let held = null;
let sending = false;

function letGo() {
  if (!held) return;
  clearInterval(held.timer);
  held.button.classList.remove("held");
  held = null;
}

// One at a time: what waits on a slow line would move the robot after the button was let go.
async function repeat() {
  if (!held || sending) return;
  sending = true;
  try { await call("/api/hold", { job: held.job, key: held.key }); } catch (error) { letGo(); say(error); }
  sending = false;
}

function press(event, job, key) {
  const button = event.currentTarget;
  event.preventDefault();
  if (event.button !== 0) return;
  letGo();
  button.setPointerCapture(event.pointerId);
  button.classList.add("held");
  held = { button, job, key, timer: setInterval(repeat, EVERY_MS) };
  repeat();
}

for (const name of ["pointerup", "pointercancel", "lostpointercapture", "blur", "pagehide"]) window.addEventListener(name, letGo);
document.addEventListener("visibilitychange", letGo);

function holders(job) {
  const box = at("hold");
  const moves = Boolean(job && job.running && !job.stopping && !job.finishing && current(job) && job.command.startsWith("hil jog"));
  if (!moves) letGo();
  box.hidden = !moves;
  if (!moves || box.dataset.job === job.name) return;
  box.dataset.job = job.name;
  const ways = job.command.includes("--body") ? OF_BODY : job.command.includes("--wheel") ? OF_WHEEL : OF_AXIS;
  box.replaceChildren(make("p", { class: "soft" }, "The robot moves while a button is held down."), ...Object.entries(ways).map(([key, way]) => {
    const button = make("button", { type: "button", "data-key": key }, way);
    button.addEventListener("pointerdown", (event) => press(event, job.name, key));
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    return button;
  }));
}
