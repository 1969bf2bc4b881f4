/* A cross-hair and enlarged parts for the figures of a page. It reads `data-readings` (numbers and names that were
   checked when the page was written) and draws with them; without it the pictures stand as they are. */
"use strict";
(() => {
const NS = new DOMParser().parseFromString("<svg></svg>", "text/html").body.firstChild.namespaceURI;
const COLOURS = { truth: 1, reference: 1, grid: 1, c1: 1, c2: 1, c3: 1, c4: 1, c5: 1 };
const tone = (c) => (COLOURS[c] ? `var(--${c})` : c);
const words = (v) => (v !== 0 && (Math.abs(v) >= 1e5 || Math.abs(v) < 1e-3) ? v.toExponential(2) : String(+v.toPrecision(4)));

function svg(parent, tag, attributes, text) {
  const made = parent.appendChild(document.createElementNS(NS, tag));
  for (const [k, v] of Object.entries(attributes)) made.setAttribute(k, v);
  if (text !== undefined) made.textContent = text;
  return made;
}

/* A side of axes: from values to places and back, on a linear, logarithmic or symmetric logarithmic scale. */
function side(scale, from, to, limits) {
  const t = scale.linear_below, adjust = 1 / 0.9;
  const bend = scale.log ? Math.log10 : t ? (v) => (Math.abs(v) <= t ? v * adjust : Math.sign(v) * t * (adjust + Math.log10(Math.abs(v) / t))) : (v) => v;
  const back = scale.log ? (u) => 10 ** u : t ? (u) => (Math.abs(u) <= t * adjust ? u / adjust : Math.sign(u) * t * 10 ** (Math.abs(u) / t - adjust)) : (u) => u;
  const [a, b] = limits.map(bend);
  return { at: (v) => from + ((bend(v) - a) / (b - a)) * (to - from), value: (p) => back(a + ((p - from) / (to - from)) * (b - a)) };
}

function ticks(low, high) {
  const [a, b] = [Math.min(low, high), Math.max(low, high)], raw = (b - a) / 5, ten = 10 ** Math.floor(Math.log10(raw));
  const step = ten * ([1, 2, 5].find((k) => k * ten >= raw) || 10), found = [];
  for (let k = Math.ceil(a / step); k * step <= b && found.length < 12; k++) found.push(+(k * step).toPrecision(12));
  return found;
}

const unit = (scale) => (/\(([^()]*)\)\s*$/.exec(scale.label) || ["", ""])[1];
const bare = (scale) => scale.label.replace(/\s*\([^()]*\)\s*$/, "");
const reading = (scale, v) => (scale.names && scale.names[String(Math.round(v))]) || `${words(v)} ${unit(scale)}`.trim();
const rising = (x) => x[0] !== x[x.length - 1] && x.every((v, k) => !k || v === null || x[k - 1] === null || v >= x[k - 1]);

class Axes {
  constructor(known) {
    this.known = known;
    const named = known.series.filter((s) => s.name);
    const read = named.length ? named : known.series.filter((s) => s.x.length > 2 || s.across || s.width === undefined);
    const along = read.every((s) => !s.across && rising(s.x)); // else the curves are paths: the nearest point counts
    this.read = read.map((s) => ({ ...s, along }));
    this.limits = [known.x.limits, known.y.limits];
    this.fit();
  }
  fit() {
    const [left, top, width, height] = this.known.box;
    this.x = side(this.known.x, left, left + width, this.limits[0]);
    this.y = side(this.known.y, top + height, top, this.limits[1]);
  }
  get enlarged() { return this.limits[0] !== this.known.x.limits || this.limits[1] !== this.known.y.limits; }
  has(px, py, room = 0) {
    const [left, top, width, height] = this.known.box;
    return px >= left - room && px <= left + width + room && py >= top - room && py <= top + height + room;
  }
  reset() { this.limits = [this.known.x.limits, this.known.y.limits]; this.fit(); }
  enlarge(x0, y0, x1, y1) {
    const [left, top, width, height] = this.known.box, clip = (v, a, b) => Math.min(Math.max(v, a), b);
    const xs = [x0, x1].map((v) => clip(v, left, left + width)).sort((a, b) => a - b);
    const ys = [y0, y1].map((v) => clip(v, top, top + height)).sort((a, b) => b - a);
    if (!this.known.zoom || xs[1] - xs[0] < 1 || ys[0] - ys[1] < 1) return;
    this.limits = [xs.map(this.x.value), ys.map(this.y.value)];
    this.fit();
  }
  /* Enlarge by a factor about a point; below 1 it goes back towards the whole. */
  about(px, py, factor) {
    const [left, top, width, height] = this.known.box, w = width / factor, h = height / factor;
    const x0 = px - (px - left) / factor, y0 = py - (py - top) / factor;
    if (factor > 1) return this.enlarge(x0, y0, x0 + w, y0 + h);
    const next = [[this.x.value(x0), this.x.value(x0 + w)], [this.y.value(y0 + h), this.y.value(y0)]], whole = [this.known.x.limits, this.known.y.limits];
    const beyond = next.map(([a, b], k) => Math.abs(b - a) >= Math.abs(whole[k][1] - whole[k][0]));
    if (beyond[0] || beyond[1] || !next.flat().every(Number.isFinite)) return this.reset();
    this.limits = next;
    this.fit();
  }
  /* The point of each series at a place: beside it along x (along y for bars that lie), else the nearest. */
  near(px, py) {
    return this.read.map((s) => {
      let best = -1, least = Infinity;
      s.x.forEach((v, k) => {
        if (v === null || s.y[k] === null) return;
        const dx = this.x.at(v) - px, dy = this.y.at(s.y[k]) - py;
        const far = s.across ? Math.abs(dy) : s.along ? Math.abs(dx) : Math.hypot(dx, dy);
        if (far < least) [best, least] = [k, far];
      });
      return best < 0 ? null : { s, k: best, x: s.x[best], y: s.y[best] };
    }).filter((p) => p && this.has(this.x.at(p.x), this.y.at(p.y), 1));
  }
  draw(over, number) {
    if (!this.enlarged) return;
    const [left, top, width, height] = this.known.box, clip = `clip${number}`;
    const cover = ([x, y, w, h]) => svg(over, "rect", { x: x - 1, y: y - 1, width: w + 2, height: h + 2, class: "cover" });
    [this.known.x.strip, this.known.y.strip, this.known.box].forEach((b) => b && cover(b));
    const defs = svg(over, "clipPath", { id: clip });
    svg(defs, "rect", { x: left, y: top, width, height });
    for (const v of ticks(...this.limits[0])) {
      svg(over, "line", { x1: this.x.at(v), x2: this.x.at(v), y1: top, y2: top + height, class: "grid" });
      svg(over, "text", { x: this.x.at(v), y: top + height + (this.known.x.strip ? 11 : -3), "text-anchor": "middle" }, words(v));
    }
    for (const v of ticks(...this.limits[1])) {
      svg(over, "line", { x1: left, x2: left + width, y1: this.y.at(v), y2: this.y.at(v), class: "grid" });
      svg(over, "text", { x: left + (this.known.y.strip ? -4 : 3), y: this.y.at(v) + 3, "text-anchor": this.known.y.strip ? "end" : "start" }, words(v));
    }
    const inside = svg(over, "g", { "clip-path": `url(#${clip})` });
    const way = (s) => s.x.map((v, k) => (v === null || s.y[k] === null ? null : `${this.x.at(v).toFixed(2)},${this.y.at(s.y[k]).toFixed(2)}`));
    for (const a of this.known.areas) svg(inside, "polygon", { points: way(a).filter(Boolean).join(" "), fill: tone(a.colour), opacity: a.opacity });
    for (const s of this.known.series) {
      const points = way(s);
      let d = "", pen = "M";
      for (const p of points) { if (p) { d += pen + p; pen = "L"; } else pen = "M"; }
      if (s.width && d) svg(inside, "path", { d, fill: "none", stroke: tone(s.colour), "stroke-width": s.width, "stroke-dasharray": s.dashed ? "5 3" : "none" });
      if (s.mark) points.forEach((p) => { if (p) svg(inside, "circle", { cx: p.split(",")[0], cy: p.split(",")[1], r: 2.2, fill: tone(s.colour) }); });
    }
    svg(over, "rect", { x: left, y: top, width, height, class: "frame" });
  }
}

function plot(box, number) {
  const known = JSON.parse(box.dataset.readings), [width, height] = known.size;
  const axes = known.axes.map((a) => new Axes({ zoom: true, series: [], areas: [], ...a }));
  const over = svg(box, "svg", { viewBox: `0 0 ${width} ${height}`, class: "over", "aria-hidden": "true" });
  const said = box.appendChild(document.createElement("div"));
  said.className = "said";
  said.setAttribute("role", "status");
  said.hidden = true;
  box.tabIndex = 0;
  box.setAttribute("role", "group");
  box.setAttribute("aria-label", `${box.firstElementChild.alt || box.firstElementChild.getAttribute("aria-label")}. Arrow keys read values, plus and minus enlarge, 0 shows the whole.`);
  let at = null, own = null, drag = null;
  const fingers = new Map();

  function place(event) {
    const frame = over.getBoundingClientRect();
    return [((event.clientX - frame.left) / frame.width) * width, ((event.clientY - frame.top) / frame.height) * height];
  }
  function pick(px, py) { return axes.find((a) => a.has(px, py)) || null; }
  function show() {
    over.replaceChildren();
    axes.forEach((a, k) => a.draw(over, `${number}-${k}`));
    said.hidden = true;
    if (drag && own) svg(over, "rect", { x: Math.min(drag[0], at[0]), y: Math.min(drag[1], at[1]), width: Math.abs(at[0] - drag[0]), height: Math.abs(at[1] - drag[1]), class: "chosen" });
    if (!at || !own) return;
    const points = own.near(...at);
    if (!points.length) return;
    const first = points[0], [left, top, w, h] = own.known.box;
    const [cx, cy] = [own.x.at(first.x), own.y.at(first.y)];
    if (first.s.across) svg(over, "line", { x1: left, x2: left + w, y1: cy, y2: cy, class: "hair" });
    else svg(over, "line", { x1: first.s.along ? cx : at[0], x2: first.s.along ? cx : at[0], y1: top, y2: top + h, class: "hair" });
    points.forEach((p) => svg(over, "circle", { cx: own.x.at(p.x), cy: own.y.at(p.y), r: 3, fill: tone(p.s.colour), class: "dot" }));
    say(points, first);
  }
  function say(points, first) {
    const { x, y } = own.known;
    said.replaceChildren();
    const line = (text, colour) => {
      const made = said.appendChild(document.createElement("div"));
      if (colour) { const dot = made.appendChild(document.createElement("i")); dot.style.background = tone(colour); }
      made.append(text);
    };
    const shared = first.s.across ? y : first.s.along ? x : null;
    const value = first.s.across ? first.y : first.x;
    const name = shared && bare(shared);
    if (shared) line(`${name ? `${name} ` : ""}${reading(shared, value)}`);
    for (const p of points) {
      const text = p.s.across ? reading(x, p.x) : p.s.along ? reading(y, p.y) : `${bare(x)} ${reading(x, p.x)}, ${bare(y)} ${reading(y, p.y)}`;
      line(`${p.s.name || (p.s.across ? bare(x) : bare(y))} ${text}`.trim(), p.s.colour);
    }
    said.hidden = false;
    const share = at[0] / width, frame = over.getBoundingClientRect();
    said.style.left = share < 0.5 ? `${Math.min(share * frame.width + 14, Math.max(0, frame.width - said.offsetWidth))}px` : `${Math.max(0, share * frame.width - 14 - said.offsetWidth)}px`;
    said.style.top = `${Math.max(0, Math.min((at[1] / height) * frame.height + 10, frame.height - said.offsetHeight))}px`;
  }

  box.addEventListener("pointermove", (event) => {
    const here = place(event);
    if (fingers.has(event.pointerId)) {
      const before = [...fingers.values()].map((p) => [...p]);
      fingers.set(event.pointerId, here);
      const now = [...fingers.values()];
      if (now.length === 2) {
        const gap = (p) => Math.hypot(p[0][0] - p[1][0], p[0][1] - p[1][1]), middle = [(now[0][0] + now[1][0]) / 2, (now[0][1] + now[1][1]) / 2];
        own = pick(...middle);
        if (own && gap(before) > 4) own.about(...middle, gap(now) / gap(before));
        at = null;
        return show();
      }
    }
    at = here;
    if (!drag) own = pick(...at);
    show();
  });
  box.addEventListener("pointerdown", (event) => {
    at = place(event);
    own = pick(...at);
    if (event.pointerType !== "mouse") fingers.set(event.pointerId, at);
    else if (event.button === 0 && own) { drag = at; box.setPointerCapture(event.pointerId); }
    show();
  });
  const end = (event) => {
    fingers.delete(event.pointerId);
    if (drag && own && Math.abs(at[0] - drag[0]) > 5) {
      const [, top, , tall] = own.known.box, flat = Math.abs(at[1] - drag[1]) <= 5;
      own.enlarge(drag[0], flat ? top : drag[1], at[0], flat ? top + tall : at[1]);
    }
    drag = null;
    show();
  };
  box.addEventListener("pointerup", end);
  box.addEventListener("pointercancel", end);
  box.addEventListener("pointerleave", () => { if (!drag) { at = null; show(); } });
  box.addEventListener("dblclick", () => { axes.forEach((a) => a.reset()); show(); });
  box.addEventListener("dragstart", (event) => event.preventDefault());
  box.addEventListener("wheel", (event) => {
    const here = place(event), under = pick(...here);
    if (!under || !(event.ctrlKey || document.activeElement === box)) return;
    event.preventDefault();
    under.about(...here, event.deltaY < 0 ? 1.25 : 0.8);
    show();
  }, { passive: false });
  box.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!own || !at) { own = axes[0]; const b = own.known.box; at = [b[0] + b[2] / 2, b[1] + b[3] / 2]; }
    const [left, top, w, h] = own.known.box;
    const here = step && step[0] && own.near(...at)[0];
    if (here && !here.s.along && !here.s.across) { // along the curve itself
      const n = here.s.x.length, k = Math.min(Math.max(here.k + step[0] * Math.ceil(n / 50), 0), n - 1);
      if (here.s.x[k] !== null && here.s.y[k] !== null) at = [own.x.at(here.s.x[k]), own.y.at(here.s.y[k])];
    } else if (step) {
      at = [Math.min(Math.max(at[0] + (step[0] * w) / 50, left), left + w), at[1] + (step[1] * h) / 10];
      const next = axes.find((a) => a !== own && a.has(...at));
      if (next) own = next;
      at[1] = Math.min(Math.max(at[1], own.known.box[1]), own.known.box[1] + own.known.box[3]);
    } else if (event.key === "+" || event.key === "=") own.about(...at, 1.5);
    else if (event.key === "-") own.about(...at, 1 / 1.5);
    else if (event.key === "0") axes.forEach((a) => a.reset());
    else if (event.key === "Escape") at = null;
    else return;
    event.preventDefault();
    show();
  });
}
document.querySelectorAll("[data-readings]").forEach(plot);
})();
