// The console: offers, starts, shows what runs, answers its questions, lists devices and results.
"use strict";
let offer = null;
let shown = "";
let trail = [];
let shownJob = "";
let wasRunning = false;
const IDLE = "Nothing has been started here yet.";
const SETTLE_MS = 700;
const asked = { question: "", since: 0, answered: "" };

async function call(path, body) {
  const post = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const reply = await fetch(path, body === undefined ? {} : post);
  const tree = await reply.json();
  if (!reply.ok) throw new Error(tree.error);
  return tree;
}

const say = (error) => { at("trouble").textContent = error ? String(error.message || error) : ""; };
const mm = (metres) => `${(1e3 * metres).toFixed(1)} mm`;
const degrees = (radians) => `${((180 / Math.PI) * radians).toFixed(1)}°`;
const known = (value, text) => (value === null || value === undefined ? "–" : text(value));

// ---- starting

function action() { return offer.actions.find((a) => a.name === at("action").value); }

function choose(name) {
  if (name) at("action").value = name;
  at("summary").textContent = action().summary;
  build(at("form"), action());
  const bench = at("form").querySelector("[name='--bench']");
  if (bench && offer.own) bench.value = offer.bench;
  same();
}

function same() {
  const values = filled(at("form"));
  const plain = action().group === "procedures" && action().name !== "a procedure of your own";
  const words = ["hil", ...(plain ? ["run", action().name] : action().name.includes(" ") ? ["run"] : [action().name])];
  for (const field of action().fields) {
    const value = values[field.name];
    if (!value) continue;
    const text = quoted(value);
    if (field.name === "moves") words.push(...`--${value}`.split(" "));
    else if (field.kind === "flag") words.push(field.name);
    else if (field.name === "SCRIPT") words.push(text);
    else if (field.name.startsWith("--")) words.push(field.name, text);
    else words.push("--set", `${field.name}=${text}`);
  }
  at("same").textContent = [...words, ...place(values)].join(" ");
}

const quoted = (text) => (/^[\w.,:@+=/-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

// Where the results go, unless that is where a terminal puts them by itself.
function place(values) {
  const name = action().name;
  if (!offer.elsewhere || name === "doctor") return [];
  const script = (values.SCRIPT || "script").replace(/^.*\//, "").replace(/\.[^.]*$/, "");
  const folder = quoted(`${offer.elsewhere}/${name.includes(" ") ? script : name}/`);
  const stamp = "$(date +%Y%m%d-%H%M%S)";
  return ["--out", `${folder}${stamp}`];
}

async function start(name, values) {
  say("");
  try {
    const answer = await call("/api/start", { action: name, values });
    if (at("start") && name === action().name) complain(at("form"), answer.problems || {});
    else if (answer.problems) say(Object.values(answer.problems).join("; "));
    await poll();
  } catch (error) { say(error); }
}

// ---- what runs

function bar(progress) {
  const left = progress.left_s === null || progress.left_s === undefined ? "" : `, about ${Math.ceil(progress.left_s)} s left`;
  const counted = progress.total > 1 ? `: ${progress.done} of ${progress.total}` : "";
  const strip = progress.total > 1 ? [make("progress", { max: progress.total, value: progress.done, "aria-label": progress.what })] : [];
  return [make("p", {}, `${progress.what}${counted}${left}`), ...strip];
}

// Figures count as those of now while the loop tells new ones.
const OLD_S = 1.5;
const current = (job) => Boolean(job && job.running && job.live && !job.watched && (job.live_age_s ?? 0) < OLD_S);

function age(job) {
  if (!job || !job.running || !job.live || current(job)) return "";
  return `These figures are ${(job.live_age_s ?? 0).toFixed(0)} s old.`;
}

const questionOf = (job) => (job && job.question !== null && job.running ? `${job.name} ${job.question_id}` : "");

function asking(job) {
  const text = make("input", { "aria-label": "Answer", placeholder: "answer, or nothing" });
  const done = make("button", { class: "main", disabled: true }, "Done");
  const form = make("form", {}, text, done);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (done.disabled) return;
    done.disabled = true;
    asked.answered = questionOf(job);
    say("");
    try {
      await call("/api/answer", { job: job.name, question_id: job.question_id, text: text.value });
    } catch (error) {
      asked.answered = "";
      say(error);
    }
    poll().catch(say);
  });
  return make("div", { class: "question" }, make("p", { role: "alert" }, make("strong", {}, job.question)), form);
}

function running(job) {
  const finish = make("button", { type: "button" }, /^hil run|^hil comm/.test(job.command) ? "Finish the step, then end" : "End it");
  finish.disabled = job.finishing;
  finish.addEventListener("click", async () => {
    finish.disabled = true;
    try { await call("/api/finish", { job: job.name }); } catch (error) { finish.disabled = false; say(error); }
  });
  return [
    make("p", {}, make("strong", {}, job.title), job.watched?.why ? " is ending" : job.stopping ? " is stopping …" : job.finishing ? " is going to end …" : " runs"),
    ...(questionOf(job) ? [asking(job)] : []), ...(job.whole && (job.whole.total > 1 || job.whole.left_s != null) ? bar(job.whole) : []),
    ...(job.progress ? bar(job.progress) : []), make("p", { class: "row" }, finish), ...viewer(job),
  ];
}

function viewer(job) {
  if (!/--rerun=\S*serve/.test(job.command)) return [];
  const url = "http://127.0.0.1:9090/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy";
  return [make("p", {}, make("a", { href: url, target: "_blank", rel: "noopener" }, "Open the view in space (Rerun)"))];
}

function ended(job) {
  const held = job.held ? [make("p", { class: "in-bar" }, make("span", { class: `tag ${job.held.state}` }, job.held.state), ` ${job.held.why}`)] : [];
  const link = job.link ? [make("p", {}, make("a", { href: job.link, target: "_blank", rel: "noopener" }, "Open the report"))] : [];
  return [
    make("p", {}, make("strong", {}, job.title), " ", make("span", { class: `tag ${job.verdict}`, id: "verdict" }, job.verdict)),
    ...(job.why ? [make("p", {}, job.why)] : []), ...held, ...link,
  ];
}

// A question takes its answer once, and none from a click that was meant for the one before it.
function settle(question) {
  if (question !== asked.question) [asked.question, asked.since] = [question, Date.now()];
  const done = at("now").querySelector(".question button");
  if (done) done.disabled = question === asked.answered || Date.now() - asked.since < SETTLE_MS;
}

function show(jobs) {
  const job = jobs[0];
  const key = JSON.stringify(job ? { ...job, live: null, live_age_s: null, watched: Boolean(job.watched?.why), events: null } : null);
  if (key !== shown) {
    shown = key;
    const parts = !job ? [make("p", {}, IDLE)] : job.running ? running(job) : ended(job);
    const before = questionOf(job) === asked.question ? at("now").querySelector(".question input") : null;
    const focused = before !== null && before === document.activeElement;
    at("now").replaceChildren(...parts);
    const now = at("now").querySelector(".question input");
    if (before && now) {
      now.value = before.value;
      if (focused) now.focus();
    }
    if (job && !job.running && job.findings) findings(job.findings);
  }
  settle(questionOf(job));
  holders(job);
  const start = at("start");
  if (start) start.disabled = Boolean(job && job.running);
  at("examine").disabled = offer === null || Boolean(job && job.running);
  const watched = job && job.running && job.watched;
  at("watched").textContent = watched ? job.watched.words : "";
  at("watched").className = watched && job.watched.why ? "wrong" : "";
  at("live").hidden = !(job && job.live);
  at("live").classList.toggle("old", !current(job));
  at("live-age").textContent = age(job);
  at("live-title").textContent = job && job.running && !watched ? "Live" : "Last figures before the stop";
  if (job && job.live) live(job);
  const events = job ? job.events : [];
  at("seen").hidden = !events.length;
  at("seen-lines").replaceChildren(...events.map((line) => make("li", {}, line)));
  at("more").hidden = !(job && job.messages.length);
  at("log").textContent = job ? job.messages.join("\n") : "";
  const isRunning = Boolean(job && job.running);
  if (wasRunning && !isRunning) history();
  wasRunning = isRunning;
}

// ---- live figures

function table(head, rows) {
  return [make("tr", {}, ...head.map((h) => make("th", { scope: "col" }, h))),
    ...rows.map((r) => make("tr", {}, ...r.map((c) => make("td", {}, c))))];
}

let force = null;

function live(job) {
  const now = job.live;
  if (shownJob !== job.name) begun(job);
  if (now.adhesion_n !== null) force = [now.adhesion_n, now.adhesion_needed_n];
  const placed = now.pose.some((value) => value !== null); // by one wheel that turns alone no pose is known
  const figures = [
    ...(placed ? [["x (up a wall)", known(now.pose[0], mm)], ["y (across it)", known(now.pose[1], mm)], ["heading", known(now.pose[2], degrees)]] : []),
    ...(placed && current(job) ? [["speed", known(now.twist[0], (x) => `${(1e3 * Math.hypot(x, now.twist[1])).toFixed(0)} mm/s`)]] : []),
    ["bench time", `${now.t_s.toFixed(1)} s`], ["pressed on", force ? `${force[0].toFixed(0)} N (${known(force[1], (n) => n.toFixed(0))} needed)` : "–"],
  ];
  at("figures").replaceChildren(...figures.map(([name, value]) => make("div", {}, make("span", { class: "soft" }, name), make("b", {}, value))));
  const wheels = ["front left", "back left", "back right", "front right"].map((name, i) => [
    name, known(now.wheel_rad_s && now.wheel_rad_s[i], (w) => `${w.toFixed(2)} rad/s`), known(now.steering_rad && now.steering_rad[i], degrees)]);
  at("wheels").replaceChildren(...table(["wheel", "turns", "steered"], wheels));
  plot(now);
  at("map").classList.toggle("unknown", !placed);
  at("wheel-list").open ||= !placed;
  map(now);
}

// Of a job that ran before this page was opened, or reloaded, the console knows what was.
async function begun(job) {
  [trail, shownJob, force] = [[], job.name, null];
  forget();
  try {
    const past = await call(`/api/past?job=${encodeURIComponent(job.name)}`);
    if (shownJob !== job.name) return;
    trail = [...past.path, ...trail];
    remember(past.latest);
  } catch (error) { say(error); }
}

function map(now) {
  const [x, y, heading] = now.pose;
  if (x === null || y === null) return;
  const last = trail.at(-1);
  if (!last || Math.hypot(last[0] - x, last[1] - y) > 0.0005) trail.push([x, y]);
  if (trail.length > 4000) trail = trail.filter((_, i) => i % 2);
  const aim = now.reference;
  const points = [...trail, [x, y], ...(aim ? [aim] : [])];
  const low = [0, 1].map((k) => Math.min(...points.map((p) => p[k])));
  const high = [0, 1].map((k) => Math.max(...points.map((p) => p[k])));
  const scale = 1 / Math.max((high[0] - low[0]) / 190, (high[1] - low[1]) / 350, 0.0005);
  const place = ([px, py]) => [200 - (py - (low[1] + high[1]) / 2) * scale, 120 - (px - (low[0] + high[0]) / 2) * scale];
  const text = (p) => place(p).map((v) => v.toFixed(1)).join(",");
  const [cx, cy] = place([x, y]);
  const turn = (-heading * 180) / Math.PI;
  const node = (tag, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  };
  const tenth = 0.1 * scale > 300 ? 0.01 : 0.1;
  const ruler = node("text", { x: 12, y: 224 });
  ruler.textContent = `${1e3 * tenth} mm; x up, y to the left`;
  const parts = [node("line", { x1: 12, y1: 230, x2: 12 + tenth * scale, y2: 230 }), ruler, node("polyline", { class: "path", points: trail.map(text).join(" ") })];
  if (aim) {
    const [ax, ay] = place(aim);
    parts.push(node("circle", { class: "aim", cx: ax, cy: ay, r: 8 }));
  }
  parts.push(node("path", { class: "robot", d: "M0,-10 L7,8 L0,4 L-7,8 Z", transform: `translate(${cx},${cy}) rotate(${turn})` }));
  at("map").replaceChildren(...parts);
}

// ---- devices

async function devices() {
  say("");
  try {
    const answer = await call(`/api/bench?name=${encodeURIComponent(at("bench").value)}`);
    at("bench-said").textContent = `${answer.bench}: ${answer.devices.length} devices${answer.start ? "" : "; its start pose is unknown: fill in “start”"}`;
    const placed = answer.devices.some((d) => d.place);
    at("devices").replaceChildren(...table(["device", "model", "is", ...(placed ? ["at"] : [])],
      answer.devices.map((d) => [d.name, d.model, d.backend, ...(placed ? [d.place] : [])])));
  } catch (error) { say(error); }
}

function findings(found) {
  const rows = found.map((f) => [
    f.device, make("span", { class: `tag ${f.level}` }, f.level),
    make("span", {}, `${f.check}: ${f.found}`, ...(f.level === "ok" ? [] : [make("div", { class: "soft" },
      [f.expected && `expected ${f.expected}`, f.remedy].filter(Boolean).join("; "))]))]);
  const bad = found.filter((f) => f.level === "failure").length;
  at("bench-said").textContent = bad ? `${bad} of ${found.length} checks failed` : `${found.length} checks, none failed`;
  at("devices").replaceChildren(...table(["device", "state", "found, and what to do"], rows));
}

// ---- history

const WITHOUT_VERDICT = ["unfinished", "foreign"];

async function history() {
  try {
    const answer = await call(`/api/results?words=${encodeURIComponent(at("words").value)}`);
    at("found").textContent = answer.found ? `${answer.found} ${answer.found === 1 ? "result" : "results"}, the latest first` : at("words").value ? "Nothing fits these words." : "Nothing has been run yet.";
    at("history").hidden = !answer.found;
    at("history").replaceChildren(...table(["when", "what", "verdict", "bench, or why"], answer.results.map((r) => [
      r.when, r.link ? make("a", { href: r.link, target: "_blank", rel: "noopener", title: r.name }, r.procedure) : r.procedure || r.name,
      make("span", { class: `tag ${r.verdict || r.kind}` }, r.verdict || (WITHOUT_VERDICT.includes(r.kind) ? r.kind : "–")), r.why || r.bench])));
  } catch (error) { say(error); }
}

// ---- begin

async function poll() { show((await call("/api/state")).jobs); }

async function watch() {
  try { await poll(); if (at("trouble").textContent.startsWith("No answer")) say(""); }
  catch (error) { say("No answer from the console. What runs goes on, and STOP above works."); }
  setTimeout(watch, 500);
}

async function begin() {
  history();
  watch();
  offer = await call("/api/offer");
  const groups = [...new Set(offer.actions.map((a) => a.group))].map((group) => make("optgroup", { label: group },
    ...offer.actions.filter((a) => a.group === group).map((a) => make("option", { value: a.name }, a.name.replaceAll("_", " ")))));
  at("action").replaceChildren(...groups);
  at("benches").replaceChildren(...offer.benches.map((b) => make("option", { value: b })));
  at("bench").value = offer.bench;
  at("action").addEventListener("change", () => choose());
  at("form").addEventListener("input", same);
  at("form").addEventListener("submit", (event) => { event.preventDefault(); start(action().name, filled(at("form"))); });
  at("look").addEventListener("click", devices);
  at("examine").addEventListener("click", () => start("doctor", { "--bench": at("bench").value }));
  at("search").addEventListener("submit", (event) => { event.preventDefault(); history(); });
  choose("bring_up");
  devices();
  await poll();
}
if (window.parent !== window) document.body.classList.add("inside"); // below the bar with STOP
begin().catch(say);
