// The bar with the button: asks the process that serves it, and that one alone.
"use strict";
const at = (id) => document.getElementById(id);
const SILENT = "No answer from the process behind STOP. Trying again …";
const GONE = "Neither the console nor the process behind STOP answers any more.";
const PATIENCE_MS = 3000;
const SETTLE_MS = 700;
let shownPort = null;
let asked = false;
let silentSince = null;
let notHeld = [];
let leftBy = "";
let leftSince = 0;

async function call(path, options) {
  const reply = await fetch(path, { signal: AbortSignal.timeout(4000), ...options });
  const tree = await reply.json();
  if (!reply.ok) throw new Error(tree.error);
  return tree;
}

function words(job) {
  if (!job.running) return job.words;
  if (job.watched?.why) return `${job.title}: the loop has stopped, and the robot is being watched`;
  if (job.watched) return `${job.title}: ${job.stopping ? "stopping …; " : ""}${job.watched.words}`;
  if (job.stopping) return `${job.title}: stopping …`;
  return job.question ? `${job.title} asks: ${job.question}` : `${job.title} runs`;
}

// A page whose console does not answer shows nothing about what runs. A running console brings STOP back.
function silent() {
  silentSince ??= Date.now();
  const gone = Date.now() - silentSince > PATIENCE_MS;
  asked = false;
  at("stop").textContent = "STOP";
  at("now").textContent = "";
  at("alarm").textContent = gone ? GONE : SILENT;
  at("secure").hidden = true;
  at("alone").hidden = true;
  at("gone").hidden = !gone;
  if (gone) at("console").hidden = true;
}

function show(state) {
  silentSince = null;
  at("gone").hidden = true;
  const now = state.jobs.length ? state.jobs.map(words).join(" · ") : "Nothing is running.";
  if (at("now").textContent !== now) at("now").textContent = now;
  notHeld = state.not_held;
  const stopped = state.jobs.filter((job) => job.running && job.watched && job.watched.why);
  const alarm = [...stopped.map((job) => `${job.title}: ${job.watched.why.split(". ")[0]}.`), ...notHeld.map((left) => left.words)].join(" ");
  if (at("alarm").textContent !== alarm) at("alarm").textContent = alarm;
  const jobs = notHeld.map((left) => left.job).join(" ");
  if (jobs !== leftBy) [leftBy, leftSince] = [jobs, Date.now()];
  at("secured").disabled = Date.now() - leftSince < SETTLE_MS; // no click that was meant for another alarm
  at("secure").hidden = !notHeld.length;
  if (asked && state.jobs.every((job) => !job.running)) asked = false;
  at("stop").textContent = asked ? "STOP …" : "STOP";
  at("console").hidden = state.page === null;
  at("alone").hidden = state.page !== null;
  if (state.page !== null && state.page !== shownPort) at("console").src = `http://${location.hostname}:${state.page}/`;
  shownPort = state.page;
  at("jobs").replaceChildren(...state.jobs.map((job) => {
    const line = document.createElement("li");
    line.textContent = words(job);
    return line;
  }));
}

async function watch() {
  try {
    show(await call("/state"));
  } catch (error) {
    silent();
  }
  setTimeout(watch, 500);
}

const post = (path, body) =>
  call(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });

at("stop").addEventListener("click", async () => {
  asked = true;
  at("stop").textContent = "STOP …";
  try {
    await post("/stop", {});
  } catch (error) {
    silent();
  }
});

// Of what the page shows, and no more: what was left since then has its alarm.
at("secured").addEventListener("click", async () => {
  try {
    await post("/secured", { jobs: notHeld.map((left) => left.job) });
    show(await call("/state"));
  } catch (error) {
    at("alarm").textContent = String(error.message || error);
  }
});
watch();
