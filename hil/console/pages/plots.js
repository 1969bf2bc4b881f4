// Values of every device over time: what the loop has told of them, twice a second, for the last minute.
"use strict";
const MOST_POINTS = 120;
let rows = [];
const byTitle = (figures) => Object.entries(figures.devices).flatMap(([name, device]) => Object.keys(device.values || {}).map((title) => `${name} ${title}`));

function forget() {
  rows = [];
  delete at("plots").dataset.shape;
  at("plots").replaceChildren();
}

function remember(earlier) {
  const first = rows.length ? rows[0].t_s : Infinity;
  rows = [...earlier.filter((figures) => figures.t_s < first), ...rows].slice(-MOST_POINTS);
}

function plot(now) {
  const last = rows.at(-1);
  if (last && now.t_s < last.t_s) rows = []; // a bench that was opened again
  if (!last || now.t_s !== last.t_s) rows.push(now);
  rows = rows.slice(-MOST_POINTS);
  const shape = JSON.stringify(byTitle(now));
  if (at("plots").dataset.shape !== shape) {
    at("plots").dataset.shape = shape;
    at("plots").replaceChildren(...Object.entries(now.devices).map(([name, device]) => panel(name, device)));
  }
  at("span").textContent = `Every device: its newest values, and the last ${(rows.at(-1).t_s - rows[0].t_s).toFixed(0)} s`;
  for (const [name, device] of Object.entries(now.devices)) update(name, device);
}

function panel(name, device) {
  return make("section", { class: "device", "data-device": name, "aria-label": name },
    make("p", { class: "head" }, make("b", {}, name.replaceAll("_", " ")), " ", make("span", { class: "rate soft" }), " ", make("span", { class: "state tag" })),
    ...Object.keys(device.values || {}).map((title) => make("figure", { "data-title": title },
      make("figcaption", { class: "soft" }, title),
      make("div", { class: "graph" }, make("span", { class: "high soft" }), make("span", { class: "low soft" })),
      make("p", { class: "values" }))));
}

const short = (value) => (value === null || value === undefined ? "–" : String(Number(value.toPrecision(3))));

function update(name, device) {
  const box = [...at("plots").children].find((one) => one.dataset.device === name);
  const due = device.due_hz ? ` of ${short(device.due_hz)}` : "";
  box.querySelector(".rate").textContent = `${short(device.rate_hz)}${due} Hz, ${device.age_ms === null || device.age_ms === undefined ? "no sample" : `${Math.max(0, device.age_ms).toFixed(0)} ms old`}`;
  const state = box.querySelector(".state");
  state.textContent = device.status;
  state.className = `state tag ${device.status === "ok" ? "ok" : "warning"}`;
  for (const figure of box.querySelectorAll("figure")) draw(figure, name, device.values[figure.dataset.title] || {});
}

function draw(figure, name, values) {
  const names = Object.keys(values);
  const series = names.map((key) => rows.map((row) => [row.t_s, row.devices[name]?.values?.[figure.dataset.title]?.[key] ?? null]));
  const known = series.flat().map(([, value]) => value).filter((value) => value !== null);
  const graph = figure.querySelector(".graph");
  graph.querySelector("svg")?.remove();
  if (!known.length) return;
  let [low, high] = [Math.min(...known), Math.max(...known)];
  graph.querySelector(".high").textContent = short(high);
  graph.querySelector(".low").textContent = short(low);
  const least = 1e-3 * Math.max(Math.abs(low), Math.abs(high), 1e-3);
  if (high - low < least) [low, high] = [low - least, high + least];
  const [begin, end] = [rows[0].t_s, Math.max(rows.at(-1).t_s, rows[0].t_s + 1e-3)];
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [key, value] of Object.entries({ viewBox: "0 0 300 60", preserveAspectRatio: "none", "aria-hidden": "true" })) svg.setAttribute(key, value);
  series.forEach((points, k) => {
    const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
    let pen = "M";
    let d = "";
    for (const [t, value] of points) {
      if (value === null) { pen = "M"; continue; }
      d += `${pen}${((300 * (t - begin)) / (end - begin)).toFixed(1)},${(58 - (56 * (value - low)) / (high - low)).toFixed(1)}`;
      pen = "L";
    }
    path.setAttribute("d", d);
    path.setAttribute("class", `series s${k % 8}`);
    svg.append(path);
  });
  graph.prepend(svg);
  figure.querySelector(".values").replaceChildren(...names.map((key, k) => make("span", {}, make("i", { class: `s${k % 8}` }), `${key.replaceAll("_", " ")} `, make("b", {}, short(values[key])))));
}
