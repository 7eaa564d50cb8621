"use strict";
// Draws the series of one mooring by uPlot: panels share time, zoom and cursor.
const byId = (id) => document.getElementById(id);
const moorings = JSON.parse(byId("data").textContent);
const plots = byId("plots"), MISSING = 65535;
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const shown = (name) => byId(name).checked;
let charts = [], current = null, view = null;

// Panels in order: title, series, unit; angles are points, as a line would cross the cut at north.
const panelsOf = (m) => [
  {title: "Heading (° magnetic)", keys: ["heading_recorded", "heading_reference", "heading_corrected"], angle: true},
  {title: `Direction of the current${m.depth === null ? "" : ` at ${m.depth} m`} (° true)`, angle: true,
   keys: ["direction_recorded", "direction_reference", "direction_corrected"]},
  {title: `Speed${m.depth === null ? "" : ` at ${m.depth} m`} (cm/s)`, keys: ["speed_reference", "speed_corrected"], zero: true},
  {title: "Eastward velocity U by depth (m)", section: "u"},
  {title: "Northward velocity V by depth (m)", section: "v"},
  {title: "Tilt (°)", keys: ["tilt"], zero: true},
  {title: "Temperature (°C)", keys: ["temperature"]},
  {title: "Depth of the instrument (m)", keys: ["depth"], down: true},
  {title: "Uncertainty σ of the corrected heading (°)", keys: ["sigma"], zero: true},
  {title: "Flag of the corrected heading", keys: ["flag"], flag: true},
].filter((panel) => panel.section ? m.section.edges : panel.keys.some((key) => key in m.series));

async function unpack(m) {
  if (m.times) return;
  const packed = Uint8Array.from(atob(m.bytes), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const raw = await new Response(stream).arrayBuffer();
  m.times = Array.from(new Float64Array(raw, 0, m.n));
  let at = 8 * m.n;
  const read = ([low, step], count) => {
    const whole = new Uint16Array(raw, at, count);
    at += 2 * count;
    return Array.from(whole, (value) => value === MISSING ? null : low + step * value);
  };
  m.values = {};
  for (const key in m.series) m.values[key] = read(m.series[key], m.n);
  const parts = ["u_recorded", "v_recorded", "u_corrected", "v_corrected"].filter((key) => key in m.section);
  if (!parts.length) return;
  const cells = (raw.byteLength - at) / 2 / parts.length;
  for (const key of parts) m.values[key] = read(m.section[key], cells);
  m.columns = cells / m.section.depths.length;
  const known = parts.flatMap((key) => m.values[key].filter((x) => x !== null).map(Math.abs)).sort((a, b) => a - b);
  m.limit = Math.max(1, Math.round(known[Math.floor(0.98 * known.length)] || 1));
}

// A section: red for positive, blue for negative velocities, drawn as one picture that the axes stretch.
const kindOf = () => shown("corrected") ? "corrected" : shown("recorded") ? "recorded" : null;

function cell(m, part, kind, column, row) {
  const reference = m.section.reference[row];
  const from = reference ? (shown("reference") ? "corrected" : null) : kind;
  return from && m.values[`${part}_${from}`][column * m.section.depths.length + row];
}

function picture(m, part) {
  const rows = m.section.depths.length, kind = kindOf(), canvas = document.createElement("canvas");
  canvas.width = m.columns;
  canvas.height = rows;
  const context = canvas.getContext("2d"), image = context.createImageData(m.columns, rows);
  for (let column = 0; column < m.columns; column++) for (let row = 0; row < rows; row++) {
    const value = cell(m, part, kind, column, row);
    if (value === null) continue;
    const part_ = Math.min(Math.abs(value) / m.limit, 1), pale = Math.round(245 * (1 - part_));
    const rgb = value > 0 ? [245 - 67 * part_, pale, pale] : [pale, Math.round(245 - 125 * part_), 245 - 40 * part_];
    image.data.set([...rgb, 255], 4 * (row * m.columns + column));
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

function drawSection(u, m, image) {
  const {left, top, width, height} = u.bbox, {depths, edges} = m.section, context = u.ctx;
  const half = depths.length > 1 ? (depths[1] - depths[0]) / 2 : 0.5;
  const [x0, x1] = edges.map((t) => u.valToPos(t, "x", true));
  const [y0, y1] = [depths[0] - half, depths[depths.length - 1] + half].map((d) => u.valToPos(d, "y", true));
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  context.imageSmoothingEnabled = false;
  context.drawImage(image, x0, y0, x1 - x0, y1 - y0);
  context.restore();
}

// Identified effects and doubtful spans: named in the first panel; shaded, or in a section outlined, unless they last throughout.
function mark(u, what) {
  if (!shown("spans")) return;
  const {left, top, width, height} = u.bbox, context = u.ctx, ratio = devicePixelRatio;
  const clamp = (x) => Math.min(Math.max(x, left), left + width);
  context.save();
  Object.assign(context, {font: `${12 * ratio}px system-ui, sans-serif`, textAlign: "left", textBaseline: "alphabetic"});
  current.spans.forEach((span, k) => {
    const x0 = span.from === null ? left : clamp(u.valToPos(span.from, "x", true));
    const x1 = span.to === null ? left + width : clamp(u.valToPos(span.to, "x", true));
    if (x1 <= x0) return;
    const times = current.times, whole = !(span.from > times[0]) && (span.to === null || span.to >= times[times.length - 1]);
    context.fillStyle = colour(span.kind) + "30";
    context.strokeStyle = colour(span.kind);
    if (what === "shade") return whole || context.fillRect(x0, top, x1 - x0, height);
    if (what === "outline" && !whole) context.strokeRect(x0, top, x1 - x0, height);
    if (charts.length && charts[0] !== u) return;
    const [x, y] = [x0 + 4 * ratio, top + (13 + 14 * (k % 3)) * ratio];
    context.fillStyle = colour("page") + "d0";
    context.fillRect(x, y - 11 * ratio, context.measureText(span.text).width, 14 * ratio);
    context.fillStyle = colour("ink");
    context.fillText(span.text, x, y);
  });
  context.restore();
}

// Dates of the ticks, as short as their distance allows.
const MONTHS = "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split(" ");
function dates(u, ticks, axis, space, step) {
  return ticks.map((t, k) => {
    const d = new Date(1000 * t), month = MONTHS[d.getUTCMonth()], year = k ? "" : ` ${d.getUTCFullYear()}`;
    const day = `${d.getUTCDate()} ${month}`, hour = d.toISOString().slice(11, step < 60 ? 19 : 16);
    return step >= 2419200 ? month + (d.getUTCMonth() ? year : ` ${d.getUTCFullYear()}`) : step >= 86400 ? day + year : k && hour > "00:00" ? hour : `${day} ${hour}`;
  });
}

function axes(panel) {
  const line = {stroke: colour("ink"), grid: {stroke: colour("line"), width: 0.5}, ticks: {stroke: colour("line"), size: 4}};
  const turn = panel.angle ? {splits: () => [0, 90, 180, 270, 360]} : panel.flag ? {splits: () => [1, 2, 3, 4]} : {};
  return [{...line, size: 28, space: 80, values: dates}, {...line, size: 48, values: (u, ticks) => ticks.map(String), ...turn}];
}

const round = (value) => value === null || value === undefined ? "–" : value.toFixed(1).replace("-", "−");

function seriesOf(panel) {
  if (panel.section) {
    const part = panel.section;
    return [{label: "value (cm/s)", paths: () => null, points: {show: false}, value: (u) => round(under(u, part))}];
  }
  return panel.keys.filter((key) => key in current.series).map((key) => {
    const kind = key.split("_")[1] || "corrected", dots = panel.angle || panel.flag || key.endsWith("reference");
    const stroke = colour(kind);
    return {
      label: key === "speed_corrected" ? "affected" : key.split("_")[1] || key, stroke,
      show: panel.keys.length === 1 || shown(kind) || (key === "speed_corrected" && shown("recorded")),
      width: 1, ...(dots ? {paths: () => null} : {}), points: {show: dots, size: 2.5, width: 0, fill: stroke, stroke},
      value: (u, value) => panel.flag ? (value === null ? "–" : value.toFixed(0)) : round(value),
    };
  });
}

// The velocity under the cursor of a section's panel.
function under(u, part) {
  const m = current, {edges, depths} = m.section, {left, top} = u.cursor;
  if (left === undefined || left < 0) return null;
  const t = u.posToVal(left, "x"), depth = top >= 0 ? u.posToVal(top, "y") : depths[0];
  const column = Math.floor((t - edges[0]) / (edges[1] - edges[0]) * m.columns);
  const step = depths.length > 1 ? depths[1] - depths[0] : 1, row = Math.round((depth - depths[0]) / step);
  const inside = column >= 0 && column < m.columns && row >= 0 && row < depths.length;
  return inside ? cell(m, part, kindOf(), column, row) : null;
}

function rangeOf(panel) {
  if (panel.angle) return () => [0, 360];
  if (panel.flag) return () => [0.5, 4.5];
  if (panel.section) {
    const rows = current.section.depths.map((_, row) => row);
    const there = rows.filter((row) => {
      for (let column = 0; column < current.columns; column++)
        if (cell(current, panel.section, "corrected", column, row) !== null) return true;
      return false;
    });
    const depths = there.length ? there.map((row) => current.section.depths[row]) : [0, 1];
    return () => [depths[0], depths[depths.length - 1]];
  }
  return (u, low, high) => low === null ? [0, 1] : panel.zero ? [0, 1.08 * high || 1] : [low - 0.05 * (high - low || 1), high + 0.05 * (high - low || 1)];
}

function build(panel) {
  const box = document.createElement("figure"), heading = document.createElement("figcaption");
  const part = panel.section, kind = kindOf();
  heading.textContent = part ? `${panel.title}, ${kind || "reference only"}; red +, blue −, full colour ±${current.limit} cm/s` : panel.title;
  box.append(heading);
  plots.append(box);
  const image = part && picture(current, part);
  const options = {
    width: plots.clientWidth, height: part ? 200 : panel.flag ? 90 : 160, series: [{}, ...seriesOf(panel)],
    axes: axes(panel), tzDate: (t) => uPlot.tzDate(new Date(1000 * t), "UTC"), legend: {live: true},
    scales: {x: {time: true}, y: {range: rangeOf(panel), dir: part || panel.down ? -1 : 1}},
    cursor: {drag: {x: true, y: false, setScale: false}, sync: {key: "time", setSeries: false, filters: {pub: (type) => type.startsWith("mousem") || type === "mouseleave"}}},
    hooks: {
      drawClear: part ? [] : [(u) => mark(u, "shade")],
      setCursor: [clock],
      draw: [(u) => { if (part) drawSection(u, current, image); mark(u, part ? "outline" : "name"); }],
      setSelect: [(u) => {
        const {left, width} = u.select;
        if (width > 3) look(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
        u.setSelect({left: 0, width: 0, top: 0, height: 0}, false);
      }],
    },
  };
  const columns = part ? [current.times.map(() => null)] : panel.keys.filter((key) => key in current.series).map((key) => current.values[key]);
  const chart = new uPlot(options, [current.times, ...columns], box);
  chart.over.addEventListener("dblclick", whole);
  pannable(chart);
  return chart;
}

// Pan with Shift, and zoom by the wheel with Ctrl, which leaves the page's own scrolling alone.
function pannable(u) {
  u.over.addEventListener("mousedown", (down) => {
    if (!down.shiftKey) return;
    down.stopImmediatePropagation();
    const [low, high] = view, width = (high - low) / u.over.clientWidth;
    const move = (e) => look(low - (e.clientX - down.clientX) * width, high - (e.clientX - down.clientX) * width);
    addEventListener("mousemove", move);
    addEventListener("mouseup", () => removeEventListener("mousemove", move), {once: true});
  }, true);
  u.over.addEventListener("wheel", (e) => {
    if (!e.ctrlKey) return;
    e.preventDefault();
    zoom(e.deltaY > 0 ? 1.25 : 0.8, u.posToVal(e.offsetX, "x"));
  }, {passive: false});
}

function look(low, high) {
  const first = current.times[0], last = current.times[current.times.length - 1];
  const span = Math.min(Math.max(high - low, 600), last - first);
  low = Math.min(Math.max(low, first), last - span);
  view = [low, low + span];
  for (const chart of charts) chart.setScale("x", {min: low, max: low + span});
}

const stamp = (t) => `${new Date(1000 * t).toISOString().slice(0, 16).replace("T", " ")} UTC`;

function clock(u) {
  byId("time").textContent = u.cursor.idx === null || u.cursor.left < 0 ? "" : stamp(current.times[u.cursor.idx]);
}

const whole = () => look(-Infinity, Infinity);
const zoom = (by, at = (view[0] + view[1]) / 2) => look(at + by * (view[0] - at), at + by * (view[1] - at));
const pan = (share) => look(view[0] + share * (view[1] - view[0]), view[1] + share * (view[1] - view[0]));

// The cursor by keys: to the next sample, whose values are read out.
function step(by) {
  const times = current.times, now = charts[0].cursor.idx ?? times.findIndex((t) => t >= view[0]);
  const next = Math.min(Math.max(now + by, 0), times.length - 1);
  if (times[next] < view[0] || times[next] > view[1]) pan(by > 0 ? 0.5 : -0.5);
  for (const chart of charts) chart.setCursor({left: chart.valToPos(times[next], "x"), top: 10});
  const said = Object.keys(current.series).map((key) => `${key.replace("_", " ")} ${round(current.values[key][next])}`);
  byId("values").textContent = `${stamp(times[next])}: ${said.join(", ")}`;
}

function draw() {
  charts.forEach((chart) => chart.destroy());
  plots.replaceChildren();
  charts = panelsOf(current).map(build);
  if (view) look(...view); else whole();
}

async function choose(name) {
  current = moorings.find((m) => m.name === name) || moorings[0];
  if (!current) return;
  view = null;
  await unpack(current);
  byId("mooring").value = current.name;
  byId("about").textContent = `${current.name}: can it be used? ${current.use || "no"}` + (current.sigma ? `, σ ${Number(current.sigma).toFixed(1)}°` : "") + `; ${current.verdict}` + (current.meaning ? `: ${current.meaning}` : ".");
  byId("values").textContent = "";
  if (current.times.length > 1) draw(); else plots.textContent = "No sample inside the deployment.";
  document.body.dataset.drawn = current.name;
}

const keys = {
  ArrowLeft: () => step(-1), ArrowRight: () => step(1), "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2),
  PageUp: () => pan(-0.5), PageDown: () => pan(0.5), Home: whole,
};
plots.addEventListener("keydown", (e) => {
  if (!(e.key in keys)) return;
  e.preventDefault();
  keys[e.key]();
});
const buttons = {in: () => zoom(0.5), out: () => zoom(2), back: () => pan(-0.5), on: () => pan(0.5), all: whole};
for (const id in buttons) byId(id).addEventListener("click", buttons[id]);
for (const name of ["recorded", "corrected", "reference", "spans"]) byId(name).addEventListener("change", draw);
for (const m of moorings) byId("mooring").append(new Option(m.name));
byId("mooring").addEventListener("change", (e) => { location.hash = e.target.value; });
addEventListener("hashchange", () => choose(decodeURIComponent(location.hash.slice(1))));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
let width = innerWidth;
addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; draw(); } });
choose(decodeURIComponent(location.hash.slice(1)));
