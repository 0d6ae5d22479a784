"use strict";
// The explorer: the map of a table's records by plotly.js, and the body of the chosen one on a canvas.

const AROUND = 40;                              // cycles on both sides of the chosen one, of a long map
const TURN = 2 * Math.PI;
const LARGEST = 32767, NO_NUMBER = -32768;      // of whole numbers of two bytes, as encoding.py packs them
const CYCLE_SECONDS = 1.6;                      // that a cycle takes at the speed shown first
const GIF_SIZE = [640, 360], GIF_CAPTION = 28;  // pixels of a body's drawing and of the line above it
const MOST_PICTURES = 300;                      // of a GIF, at 25 a second or fewer
// Colours of the page in a light and in a dark scheme; outcomes and limbs keep their own in both. Text has a
// contrast of at least 4.5 : 1 against what is behind it.
const SCHEMES = {
  light: { paper: "#fff", ink: "#1d2125", faint: "#5c636b", grid: "#eee", axis: "#888", edge: "#333", mark: "#000", halo: "#fff",
    bar: "#f1f2f4", trail: "rgba(90,95,105,.35)", dot: "rgba(0,0,0,.5)", hatch: "#888",
    body: "#DDE0E4", near: "#BFC4CC", bone: "#4A4F57", strip: "#F1EEE8", tick: "#CFC9BE", length: "#6B665B" },
  dark: { paper: "#14181c", ink: "#e6e9ed", faint: "#a7afb8", grid: "#2a3036", axis: "#8b939c", edge: "#d5dade", mark: "#fff", halo: "#000",
    bar: "#262c32", trail: "rgba(170,178,188,.4)", dot: "rgba(0,0,0,.6)", hatch: "#3c4148",
    body: "#39414a", near: "#525c67", bone: "#b4bcc5", strip: "#20252a", tick: "#454d55", length: "#a7afb8" },
};
const darkness = matchMedia("(prefers-color-scheme: dark)");
let shade = SCHEMES[darkness.matches ? "dark" : "light"];
// The side view's own drawing: gaitsweep/view/movie/side_view.py.
const ASIDE = [0.28, 0.22];
const SERIES = ["#E69F00", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#56B4E9"];
const SWING = "#D55E00";                        // of limbs off the ground, where limbs have no colours of their own
const SYMBOLS = { "o": "circle", "s": "square", "^": "triangle-up", "D": "diamond", "v": "triangle-down",
  "<": "triangle-left", ">": "triangle-right", "x": "x", "P": "cross", "X": "x", "*": "star" };
const FONT = "system-ui, -apple-system, Segoe UI, Roboto, DejaVu Sans, sans-serif";

// Of plotly.js' buttons those that stay in the page: others offer an upload.
const BUTTONS = [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]];
const NO_UPLOAD = { modeBarButtons: BUTTONS, showSendToCloud: false, plotlyServerURL: "", topojsonURL: "about:blank", displaylogo: false };
// A finger scrolls the page; it does not zoom the map.
const TOUCH = matchMedia("(pointer: coarse)").matches;

// What a record is beside another of another gait, for kinds whose rows have several gaits.
const ELSEWHERE = { staircase: "Nearest stair with another gait", ramp: "Nearest crossing with another gait",
  continuation: "Nearest point of another gait", atlas: "Nearest point of another gait" };

const $ = id => document.getElementById(id);
const mod = (a, n) => ((a % n) + n) % n;
const painted = () => new Promise(done => requestAnimationFrame(() => setTimeout(done, 0)));

// ------------------------------------------------------------------------------- unpacking

function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);  // browsers of 2025
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

async function unpacked(id) {
  const stream = new Blob([bytesOf($(id).textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  const text = await new Response(stream).text();
  $(id).remove();
  return text;
}

function numbersOf(text) {
  const bytes = bytesOf(text), n = bytes.length / 2, numbers = new Int16Array(n);
  for (let i = 0; i < n; i++) numbers[i] = bytes[i] | (bytes[n + i] << 8);
  return numbers;
}

/** Pictures of a stretch: points (m) by picture, and the camera's place (m). */
function picturesOf(motion) {
  if (motion.points === undefined) return null;
  if (motion.unpacked) return motion.unpacked;
  const steps = numbersOf(motion.points), n = motion.pictures, columns = steps.length / n;
  const points = Array.from({ length: n }, () => new Float64Array(columns));
  for (let c = 0; c < columns; c++) {
    let at = 0;
    for (let k = 0; k < n; k++) points[k][c] = (at += steps[c * n + k]) * motion.unit;
  }
  return motion.unpacked = { points, camera: points.map(each => motion.ground + each[columns - 1]) };
}

/** The observables over the cycles: an array of numbers (null where there is none) for each series. */
function seriesOf(walk) {
  const whole = numbersOf(walk.crossings.values), count = data.series.length, n = count ? whole.length / count : 0;
  return data.series.map((series, s) => Array.from({ length: n }, (_, k) => {
    const q = whole[s * n + k];
    return q === NO_NUMBER ? null : series.low + (q + LARGEST) / (2 * LARGEST) * (series.high - series.low);
  }));
}

// ------------------------------------------------------------------------------- the table

let data, count;                                  // the page's fields, and how many records it has
let columns = {};                                 // columns by name
let slice = [];                                   // the value shown of each axis that is not drawn
let chosen = -1, other = -1;                      // the record, and the nearest one that leads elsewhere
let recordAt = new Map();                         // of cells: the record by slice and cell
let recordsOf = new Map();                        // records of a row, in their order

const raw = (column, i) => Array.isArray(column.values) ? column.values[i] : column.values;
const numberAt = (name, i) => { const v = raw(columns[name], i); return v === null ? NaN : Number(v); };

function textOf(column, i) {
  const value = raw(column, i);
  if (column.categories) return value < 0 ? "" : column.categories[value];
  if (value === null) return "no number";
  return String(Number.isInteger(value) || typeof value === "string" ? value : Number(value.toPrecision(7))).replaceAll("-", "−");
}

function inPi(angle) {
  const turns = Math.round(angle / Math.PI * 1e4) / 1e4, quarters = turns * 4;
  const sign = turns < 0 ? "−" : "", size = Math.abs(turns);
  if (size === 0) return "0";
  if (Number.isInteger(turns)) return `${sign}${size === 1 ? "" : size}π`;
  if (Number.isInteger(quarters)) {
    const below = Number.isInteger(2 * turns) ? 2 : 4, top = size * below;
    return `${sign}${top === 1 ? "" : top}π/${below}`;
  }
  return `${sign}${Number(size.toPrecision(5))}π`;
}

/** HTML without its tags, and with letters instead of entities. */
function plain(text) {
  const box = document.createElement("template");
  box.innerHTML = text;
  return box.content.textContent;
}

/** Text as HTML; plotly.js reads no other entities. */
const escaped = text => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
/** The luminance of a colour #rrggbb, from 0 to 1 (WCAG 2.2, relative luminance). */
function luminance(colour) {
  const parts = [1, 3, 5].map(k => parseInt(colour.slice(k, k + 2), 16) / 255).map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2];
}

/** A colour of a figure; in a dark scheme one that is nearly black is lighter, 3 : 1 against the paper. */
function seen(colour) {
  if (shade !== SCHEMES.dark) return colour;
  const behind = luminance(shade.paper) + 0.05, parts = [1, 3, 5].map(k => parseInt(colour.slice(k, k + 2), 16));
  let found = colour;
  for (let white = 0; (luminance(found) + 0.05) / behind < 3; white += 0.05)
    found = "#" + parts.map(c => Math.round(c + white * (255 - c)).toString(16).padStart(2, "0")).join("");
  return found;
}

/** A limb's colour; black, where limbs are all alike, is that of the ink. */
const limbColour = limb => limb.colour === "#000000" ? shade.mark : seen(limb.colour);

const outcomeOf = i => data.outcomes[data.outcome[i]];
const sliceKey = i => data.slices.map(each => each.of[i]).join(",");
/** The branch of a record, in an atlas, whose rows have several. */
const branchOf = i => data.run === "atlas" ? raw(columns.number, i) : 0;
const shownKey = () => slice.join(",");
const nameOf = i => {
  const row = raw(columns.row, i), mine = recordsOf.get(row);
  return mine.length > 1 ? `row ${row}, record ${mine.indexOf(i) + 1} of ${mine.length}` : `row ${row}`;
};

function valueText(name, i) {
  const column = columns[name], value = numberAt(name, i);
  if (!Number.isFinite(value)) return textOf(column, i);
  const unit = column.unit ? ` ${column.unit}` : "";
  return column.circular ? inPi(value) : `${Number(value.toPrecision(5))}`.replaceAll("-", "−") + unit;
}

/** A coordinate on an axis: angles lie in the turn that begins at the axis's origin. */
function along(axis, value) {
  return axis.circular && data.kind === "points" ? axis.origin + mod(value - axis.origin, TURN) : value;
}

// ------------------------------------------------------------------------------- the map

function piTicks(low, high) {
  const steps = [0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1];
  const step = Math.PI * (steps.find(each => (high - low) / (each * Math.PI) <= 6) ?? 1), values = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9; k++) values.push(k * step);
  return { tickvals: values, ticktext: values.map(inPi) };
}

/** Where a value stands along an axis: its logarithm to base 10 where the axis is logarithmic. */
const onScale = (axis, value) => axis.log ? Math.log10(value) : value;
const offScale = (axis, at) => axis.log ? 10 ** at : at;

function axisOf(axis, range) {
  const layout = { title: { text: axis.label, standoff: 8 }, range, zeroline: false, ticks: "outside", showline: true,
    linecolor: shade.axis, tickcolor: shade.axis, showgrid: data.kind === "points", gridcolor: shade.grid, automargin: true };
  if (axis.log) return { ...layout, type: "log", tickformat: "~g" };
  return { ...layout, type: "linear", ...(axis.circular ? piTicks(...range) : {}) };
}

/** The ranges of the axes, in places along them. */
function ranges() {
  if (data.kind === "cells") return [data.x, data.y].map((axis, k) => [data.edges[k][0], data.edges[k].at(-1)].map(edge => onScale(axis, edge)));
  return [data.x, data.y].map(axis => {
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < count; i++) {
      const value = onScale(axis, along(axis, numberAt(axis.name, i)));
      if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    }
    if (!(low <= high)) { low = 0; high = 1; }
    const room = 0.04 * (high - low) || 0.5;
    return [low - room, high + room];
  });
}

const marker = (outcome, size) => ({ size, symbol: (SYMBOLS[outcome.marker] || "circle") + (outcome.hollow ? "-open" : ""),
  color: seen(outcome.colour), line: { width: outcome.hollow ? 1.6 : 0.5, color: outcome.hollow ? seen(outcome.colour) : shade.edge } });

function told(i) {
  const [x, y] = [data.x, data.y].map(axis => `${axis.label} ${escaped(valueText(axis.name, i))}`);
  const way = data.passes.length ? `, ${escaped(passText(passOf(i)))}` : "";
  return `${x}<br>${y}<br>${escaped(outcomeOf(i).name)}${way}, ${nameOf(i)}`;
}

const middle = (axis, edges, k) => offScale(axis, 0.5 * (onScale(axis, edges[k]) + onScale(axis, edges[k + 1])));

function cellTraces() {
  const [xs, ys] = data.edges, across = xs.length - 1, up = ys.length - 1, last = data.outcomes.length - 1;
  const z = Array.from({ length: up }, () => new Array(across).fill(null));
  const text = Array.from({ length: up }, () => new Array(across).fill(""));
  const hatched = { x: [], y: [] }, walking = { x: [], y: [] }, key = shownKey();
  for (let i = 0; i < count; i++) {
    if (sliceKey(i) !== key) continue;
    const a = data.at[0][i], b = data.at[1][i], centre = [middle(data.x, xs, a), middle(data.y, ys, b)];
    z[b][a] = data.outcome[i];
    text[b][a] = told(i);
    const into = outcomeOf(i).hatched ? [hatched] : [];
    if (walkOf.has(i)) into.push(walking);
    for (const each of into) { each.x.push(centre[0]); each.y.push(centre[1]); }
  }
  const scale = [];
  data.outcomes.forEach((outcome, k) => scale.push(...[k, k + 1].map(end => [end / (last + 1), seen(outcome.colour)])));
  const size = Math.max(3, Math.min(12, 300 / Math.max(across, up)));
  const over = { type: "scatter", mode: "markers", hoverinfo: "skip", showlegend: false };
  return [
    { type: "heatmap", x: xs, y: ys, z, text, hovertemplate: "%{text}<extra></extra>", zmin: -0.5, zmax: last + 0.5, colorscale: scale, showscale: false },
    { ...over, ...hatched, marker: { symbol: "line-ne-open", size, color: shade.hatch, line: { width: 1, color: shade.hatch } } },
    { ...over, ...walking, marker: { symbol: "circle", size: Math.min(4, size / 2), color: shade.dot } },
  ];
}

const passOf = i => data.passes[numberAt("pass", i)];
const passText = pass => `${plain(columns[data.moved].symbol)} ${pass.rises ? "rises" : "falls"}`;

/** The line between two consecutive records of a row: dashed where a parameter falls or a gait is unstable. */
function pieceStyle(i, j) {
  if (data.passes.length) return { width: 1.2, color: seen(passOf(j).colour), dash: passOf(j).rises ? "solid" : "dash" };
  if (!columns.stable) return { width: 0.8, color: shade.trail };
  // a bifurcation is on the border of both, and a kink of the map is no part of a branch
  const special = k => textOf(columns.special, k);
  if (special(j) === "kink") return { width: 1, color: shade.trail, dash: "dot" };
  return { width: 1.8, color: shade.bone, dash: outcomeOf(special(i) ? j : i).hollow ? "dash" : "solid" };
}

function pointTraces() {
  const traces = [], key = shownKey(), size = count > 1500 ? 4 : count > 400 ? 6 : 8;
  const lines = new Map();  // pieces by their style
  for (const records of data.noChange === null && recordsOf.size < count ? recordsOf.values() : []) {
    let before = -1;
    for (const i of records) {
      if (sliceKey(i) !== key) continue;
      const last = before;
      before = i;
      if (last < 0 || branchOf(last) !== branchOf(i)) continue;
      const [from, to] = [last, i].map(k => [along(data.x, numberAt(data.x.name, k)), along(data.y, numberAt(data.y.name, k))]);
      if ([data.x, data.y].some((axis, k) => axis.circular && Math.abs(to[k] - from[k]) > Math.PI)) continue;
      const line = pieceStyle(last, i), name = JSON.stringify(line);
      if (!lines.has(name)) lines.set(name, { type: "scatter", mode: "lines", x: [], y: [], line, hoverinfo: "skip" });
      const { x, y } = lines.get(name);
      if (x.at(-1) !== from[0] || y.at(-1) !== from[1]) { x.push(null, from[0]); y.push(null, from[1]); }
      x.push(to[0]); y.push(to[1]);
    }
  }
  traces.push(...lines.values());
  if (data.noChange !== null) {
    const range = ranges()[0].map(at => offScale(data.x, at));
    traces.push({ type: "scatter", mode: "lines", x: range, y: range.map(at => data.noChange * at), line: { width: 1, dash: "dot", color: shade.axis }, hoverinfo: "skip" });
  }
  data.outcomes.forEach((outcome, number) => {
    const look = marker(outcome, size), symbol = data.passes.length ? [] : look.symbol;
    const trace = { type: "scatter", mode: "markers", x: [], y: [], customdata: [], text: [], hovertemplate: "%{text}<extra></extra>", marker: { ...look, symbol } };
    for (let i = 0; i < count; i++) {
      if (data.outcome[i] !== number || sliceKey(i) !== key) continue;
      trace.x.push(along(data.x, numberAt(data.x.name, i)));
      trace.y.push(along(data.y, numberAt(data.y.name, i)));
      trace.customdata.push(i);
      trace.text.push(told(i));
      if (data.passes.length) symbol.push(SYMBOLS[passOf(i).marker] + (outcome.hollow ? "-open" : ""));
    }
    traces.push(trace);
  });
  return traces;
}

/** The mark of a record on the map: its cell's edge, or a ring around its point. */
function mark(i, look) {
  if (i < 0 || sliceKey(i) !== shownKey()) return [];
  const line = { color: look.colour, width: look.width, dash: look.dash };
  if (data.kind === "cells") {
    const [xs, ys] = data.edges, a = data.at[0][i], b = data.at[1][i];
    return [{ type: "rect", x0: xs[a], x1: xs[a + 1], y0: ys[b], y1: ys[b + 1], line }];
  }
  // a circle in pixels, as a path: on a logarithmic axis plotly.js takes the logarithm of a circle's own pixels
  const r = look.radius, c = 0.5523 * r;
  const path = `M${r},0C${r},${c} ${c},${r} 0,${r}C${-c},${r} ${-r},${c} ${-r},0C${-r},${-c} ${-c},${-r} 0,${-r}C${c},${-r} ${r},${-c} ${r},0Z`;
  return [{ type: "path", xsizemode: "pixel", ysizemode: "pixel", path, line,
    xanchor: along(data.x, numberAt(data.x.name, i)), yanchor: along(data.y, numberAt(data.y.name, i)) }];
}

const marks = () => [
  ...mark(other, { colour: shade.halo, width: 4, radius: 9 }), ...mark(other, { colour: shade.mark, width: 1.6, dash: "dot", radius: 9 }),
  ...mark(chosen, { colour: shade.halo, width: 5.5, radius: 10 }), ...mark(chosen, { colour: shade.mark, width: 2.5, radius: 10 }),
];

const MARGIN = { l: 62, r: 12, t: TOUCH ? 8 : 30, b: 52 };
const isSquare = () => data.x.circular && data.y.circular && data.kind === "cells";

function sizeOfMap() {
  const width = $("map").clientWidth;
  return [width, Math.min(isSquare() ? width * 0.98 : width * 0.8, Math.max(360, innerHeight * 0.78))];
}

/** What figures of plotly.js have in common. */
const figureLayout = size => ({ font: { family: FONT, size, color: shade.ink }, hovermode: "closest", paper_bgcolor: shade.paper, plot_bgcolor: shade.paper,
  hoverlabel: { bgcolor: shade.paper, bordercolor: shade.ink, font: { family: FONT, color: shade.ink } },
  modebar: { bgcolor: "rgba(0,0,0,0)", color: shade.faint, activecolor: shade.ink } });

/** The map without axes, for as long as plotly.js is being read. */
function sketchMap() {
  const box = $("map"), canvas = document.createElement("canvas"), [width, height] = sizeOfMap(), [across, up] = ranges(), key = shownKey();
  box.style.height = `${height}px`;
  canvas.className = "sketch";
  box.replaceChildren(canvas);
  const { pen } = surface(canvas);
  let [left, top, wide, high] = [MARGIN.l, MARGIN.t, width - MARGIN.l - MARGIN.r, height - MARGIN.t - MARGIN.b];
  if (isSquare()) { const side = Math.min(wide, high); left += (wide - side) / 2; top += (high - side) / 2; wide = high = side; }
  const x = value => left + wide * (onScale(data.x, value) - across[0]) / (across[1] - across[0]);
  const y = value => top + high * (1 - (onScale(data.y, value) - up[0]) / (up[1] - up[0]));
  for (let i = 0; i < count; i++) {
    if (sliceKey(i) !== key) continue;
    pen.fillStyle = seen(outcomeOf(i).colour);
    if (data.kind === "cells") {
      const [xs, ys] = data.edges, a = data.at[0][i], b = data.at[1][i];
      pen.fillRect(x(xs[a]), y(ys[b + 1]), x(xs[a + 1]) - x(xs[a]) + 0.5, y(ys[b]) - y(ys[b + 1]) + 0.5);
    } else pen.fillRect(x(along(data.x, numberAt(data.x.name, i))) - 2, y(along(data.y, numberAt(data.y.name, i))) - 2, 4, 4);
  }
}

async function drawMap() {
  if (!window.Plotly) { sketchMap(); return; }
  const [width, height] = sizeOfMap(), square = isSquare(), [across, up] = ranges();
  if ($("map").querySelector(".sketch")) $("map").replaceChildren();
  const layout = { ...figureLayout(13), width, height, margin: MARGIN, showlegend: false,
    xaxis: axisOf(data.x, across), yaxis: axisOf(data.y, up), shapes: marks(), dragmode: TOUCH ? false : "zoom" };
  if (square) { layout.yaxis.scaleanchor = "x"; layout.yaxis.constrain = "domain"; layout.xaxis.constrain = "domain"; }
  const traces = data.kind === "cells" ? cellTraces() : pointTraces();
  await Plotly.react("map", traces, layout, { ...NO_UPLOAD, displayModeBar: TOUCH ? false : "hover", doubleClick: "reset" });
}

// ------------------------------------------------------------------------------- neighbours

/** The distance of two records on the map: in cells, or in shares of the axes. */
function distance(i, j) {
  let sum = 0;
  if (data.kind === "cells") {
    for (const k of [0, 1]) {
      let apart = Math.abs(data.at[k][i] - data.at[k][j]);
      if (data.closed[k]) apart = Math.min(apart, data.edges[k].length - 1 - apart);
      sum += apart * apart;
    }
    return Math.sqrt(sum);
  }
  [data.x, data.y].forEach((axis, k) => {
    let apart = Math.abs(onScale(axis, numberAt(axis.name, i)) - onScale(axis, numberAt(axis.name, j)));
    if (axis.circular) { apart = mod(apart, TURN); apart = Math.min(apart, TURN - apart); }
    sum += (apart / spans[k]) ** 2;
  });
  return Math.sqrt(sum);
}

let spans = [1, 1];

function nearest(i, fits) {
  const key = sliceKey(i);
  let best = -1, least = Infinity;
  for (let j = 0; j < count; j++) {
    if (j === i || sliceKey(j) !== key || !fits(j)) continue;
    const apart = distance(i, j);
    if (apart < least) { least = apart; best = j; }
  }
  return best;
}

// ------------------------------------------------------------------------------- the chosen record

let walkOf = new Map();                           // walks by record
let walk = null, motion = null;                   // what is shown, and the stretch of it

/** The walk of a record: its own, or that of the row (of kinds whose rows walk as a whole). */
function walkFor(i) {
  if (walkOf.has(i)) return [walkOf.get(i), i];
  for (const j of recordsOf.get(raw(columns.row, i)))
    if (data.run === "return_map" && walkOf.has(j)) return [walkOf.get(j), i];
  const near = nearest(i, j => walkOf.has(j) && data.outcome[j] === data.outcome[i]);
  return near < 0 ? [null, -1] : [walkOf.get(near), near];
}

function choose(i, { announce = true } = {}) {
  if (!(i >= 0 && i < count)) return;
  chosen = i;
  const mine = data.slices.map(each => each.of[i]), moved = mine.join() !== slice.join();
  slice = mine;
  other = nearest(i, j => outcomeOf(j).leads !== outcomeOf(i).leads);
  if (moved) { showSlices(); drawMap(); showLegend(); } else if ($("map").layout) Plotly.relayout("map", { shapes: marks() });
  const row = raw(columns.row, i), place = recordsOf.get(row).indexOf(i);
  const hash = recordsOf.get(row).length > 1 ? `#row=${row},${place}` : `#row=${row}`;
  if (location.hash !== hash) history.replaceState(null, "", hash);
  showRecord();
  showWalk();
  if (announce) $("live").textContent = `${nameOf(i)}: ${plain(data.x.label)} ${valueText(data.x.name, i)}, `
    + `${plain(data.y.label)} ${valueText(data.y.name, i)}, ${outcomeOf(i).name}`;
}

function chip(outcome) {
  const span = document.createElement("span");
  span.className = `chip${outcome.hollow ? " hollow" : ""}${outcome.hatched ? " hatched" : ""}`;
  span.style.backgroundColor = seen(outcome.colour);
  if (outcome.hollow) span.style.borderColor = seen(outcome.colour);
  return span;
}

function hashOf(i) {
  const row = raw(columns.row, i), mine = recordsOf.get(row);
  return mine.length > 1 ? `#row=${row},${mine.indexOf(i)}` : `#row=${row}`;
}

/** A record's name, its place on the map and its slices. */
function titleHtml(i) {
  const where = [data.x, data.y].map(axis => `${columns[axis.name].symbol} = ${escaped(valueText(axis.name, i))}`);
  return [`${nameOf(i)}: ${where.join(", ")}`, ...data.slices.map(each => each.texts[each.of[i]])].join("; ");
}

function showRecord() {
  const i = chosen, outcome = outcomeOf(i), status = textOf(columns.status, i);
  $("chosen").innerHTML = titleHtml(i);
  $("ended").replaceChildren(chip(outcome), outcome.name);
  const period = status === "settled" && columns.attractor_period ? numberAt("attractor_period", i) : NaN;
  const sentence = !(period > 0) ? data.statuses[status]
    : `The state at the section repeats ${period === 1 ? "at a fixed point" : `on an orbit of ${period} crossings`}.`;
  const whole = recordsOf.get(raw(columns.row, i)).length > 1 ? "the whole row: " : "";
  if (data.passes.length) $("ended").append(`; ${passText(passOf(i))}`);
  $("ended").append(`; ${whole}${status}${sentence ? ": " + sentence : ""}`);
  const link = $("elsewhere");
  link.replaceChildren();
  if (other >= 0) {
    const a = document.createElement("a"), target = outcomeOf(other);
    a.href = hashOf(other);
    a.append(chip(target), `${target.name} (${nameOf(other)})`);
    const apart = distance(i, other);
    const far = data.kind === "cells" ? `, ${Number(apart.toPrecision(3))} cell${apart === 1 ? "" : "s"} away` : "";
    link.append(`${ELSEWHERE[data.run] || "Nearest start with another outcome"}: `, a, far + ".");
  } else link.textContent = "All records shown here have the same gait.";
  const lines = data.columns.map(column => {
    const line = document.createElement("tr"), head = document.createElement("th"), value = document.createElement("td");
    const meaning = document.createElement("td");
    head.scope = "row";
    head.innerHTML = column.symbol;
    if (plain(column.symbol) !== column.name) {
      const code = document.createElement("code");
      code.textContent = column.name;
      head.append(code);
    }
    value.className = "value";
    value.dataset.column = column.name;
    value.textContent = textOf(column, i) + (column.unit && raw(column, i) !== null ? ` ${column.unit}` : "");
    meaning.className = "meaning";
    const angle = column.circular && Number.isFinite(numberAt(column.name, i)) ? `${inPi(numberAt(column.name, i))}` : "";
    meaning.textContent = [angle, column.meaning].filter(Boolean).join("; ");
    line.append(head, value, meaning);
    return line;
  });
  $("record").tBodies[0].replaceChildren(...lines);
}

function showWalk() {
  const [found, owner] = walkFor(chosen), before = motion ? motion.name : null;
  walk = found;
  const note = $("instead"), texts = [];
  if (!walk && !columns.multiplier) texts.push("The page has no animation of this outcome here.");
  else if (walk && owner !== chosen) texts.push(`The animation shows ${nameOf(owner)}, the nearest record with this outcome that has one; records with an animation have a dot on the map.`);
  if (walk && walk.later) texts.push(`When it was simulated again with intermediate samples, this start ended with the gait ${walk.later}: it is on a boundary, or drifts.`);
  if (walk && walk.apart) texts.push(`When it was simulated again with intermediate samples, its phases differed by ${walk.apart.toPrecision(2)} rad from those of the record.`);
  note.hidden = !texts.length;
  note.textContent = texts.join(" ");
  const group = $("stretches");
  group.replaceChildren();
  const motions = walk ? walk.motions : [];
  motions.forEach((each, k) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = each.name;
    button.onclick = () => showMotion(k);
    group.append(button);
  });
  const loop = motions.findIndex(each => each.name === before);
  showMotion(loop >= 0 ? loop : Math.max(0, motions.length - 1));
  showPhases();
}

let beside = null;                                // the motion of the nearest start with another outcome, if shown

/** Show the nearest start with another outcome in step with the chosen one, if that is asked for. */
function showBeside() {
  const [theirs, owner] = other < 0 ? [null, -1] : walkFor(other), both = motion && motion.points !== undefined && theirs;
  const drawn = both ? theirs.motions.filter(each => each.points !== undefined) : [];
  $("compare").hidden = !drawn.length;
  const on = drawn.length && $("compare").getAttribute("aria-pressed") === "true";
  beside = on ? drawn.find(each => each.name === motion.name) || drawn.at(-1) : null;
  $("beside").hidden = !beside;
  $("body-name").replaceChildren(...(beside ? [chip(outcomeOf(chosen)), `${outcomeOf(chosen).name}, ${nameOf(walkFor(chosen)[1])}`] : []));
  $("beside-name").replaceChildren(...(beside ? [chip(outcomeOf(other)), `${outcomeOf(other).name}, ${nameOf(owner)}`] : []));
  $("beside-body").setAttribute("aria-label", beside ? `stick figure of ${nameOf(owner)}, ${beside.name}` : "");
}

/** A job of one record's row in Python. */
function pythonOf(i) {
  const values = data.varied.map(name => `${JSON.stringify(name)}: [${raw(columns[name], i)}]`).join(", ");
  return data.python.replace("@row@", () => raw(columns.row, i)).replace("@vary@", () => values);
}

async function copy(text, what) {
  try { await navigator.clipboard.writeText(text); } catch {  // pages of files may lack a clipboard
    const box = document.createElement("textarea");
    box.value = text;
    document.body.append(box);
    box.select();
    document.execCommand("copy");
    box.remove();
  }
  $("live").textContent = $("copied").textContent = `${what} of ${nameOf(chosen)} copied`;
}

function showMotion(k) {
  motion = walk && walk.motions.length ? walk.motions[k] : null;
  [...$("stretches").children].forEach((button, j) => button.setAttribute("aria-pressed", j === k));
  clock.at = 0;
  clock.turns = 0;
  const drawn = motion && motion.points !== undefined;
  $("stretches").hidden = !motion;
  $("bodies").hidden = $("save-gif").hidden = !drawn;
  showBeside();
  $("controls").hidden = !motion || (!drawn && !motion.contact.length);
  $("footfalls").hidden = $("footfalls-title").hidden = !motion || !motion.contact.length;
  $("body").setAttribute("aria-label", drawn ? `stick figure of ${nameOf(chosen)}, ${motion.name}` : "");
  $("footfalls").setAttribute("aria-label", "footfall diagram: when each foot is on the ground");
  document.querySelectorAll("#bodies, #footfalls, #footfalls-title, #controls, #stretches").forEach(each => each.style.display = each.hidden ? "none" : "");
  paint();
}

// ------------------------------------------------------------------------------- time

const clock = { at: 0, turns: 0, playing: false, speed: 1, last: 0 };
const lengthOf = each => (each.samples - 1) * each.sample;

function tick(now) {
  if (clock.playing && motion) {
    const length = lengthOf(motion), pause = motion.loops ? 0 : 0.6 * clock.speed;
    clock.at += Math.min(now - clock.last, 100) / 1000 * clock.speed;
    while (clock.at > length + pause) { clock.at -= length + pause; clock.turns += 1; }
    paint();
  }
  clock.last = now;
  requestAnimationFrame(tick);
}

function play(on) {
  clock.playing = on;
  $("play").textContent = on ? "❚❚" : "▶";
  $("play").setAttribute("aria-label", on ? "pause" : "play");
}

function paint() {
  if (!motion) { $("clock").textContent = ""; return; }
  const length = lengthOf(motion), at = Math.min(clock.at, length);
  $("time").value = length ? Math.round(at / length * 1000) : 0;
  $("clock").textContent = `${(motion.begin + at).toFixed(2)} s`;
  if (motion.points !== undefined) paintBody($("body"), motion, at, clock.turns);
  if (beside) paintBeside($("beside-body"), beside, at, clock.turns * length + at);
  if (motion.contact.length) paintFootfalls(at);
}

/** Draw the body beside the chosen one, at a time (s) of the chosen one's stretch and after all its turns. */
function paintBeside(canvas, beside, at, passed) {
  const whole = lengthOf(beside);
  if (beside.loops) paintBody(canvas, beside, passed % whole, Math.floor(passed / whole));
  else paintBody(canvas, beside, Math.min(at, whole), 0);
}

/** The context of a canvas, cleared, and its size; that of a canvas outside the page is its own. */
function surface(canvas) {
  if (!canvas.isConnected) {
    const pen = canvas.getContext("2d"), { width, height } = canvas;
    pen.clearRect(0, 0, width, height);
    return { pen, width, height };
  }
  const scale = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

// ------------------------------------------------------------------------------- the body

/** The points and the camera at a time (s) of a stretch after some turns of it, linear between pictures. */
function bodyAt(motion, at, turns) {
  const { points, camera } = picturesOf(motion), step = motion.sample * motion.stride;
  const k = Math.min(Math.floor(at / step), points.length - 1), next = Math.min(k + 1, points.length - 1);
  const share = Math.min(at / step - k, 1), mix = (a, b) => a + share * (b - a);
  const advance = motion.loops ? turns * (camera[camera.length - 1] - camera[0]) : 0;
  return { points: points[k].map((each, c) => mix(each, points[next][c])), camera: mix(camera[k], camera[next]) + advance };
}

/** How far the camera goes in a stretch, m. */
function wayOf(each) {
  const { camera } = picturesOf(each);
  return camera[camera.length - 1] - camera[0];
}

/** Whether a limb is on the ground at a time (s) of a stretch. */
function down(motion, limb, at) {
  const sample = Math.min(Math.round(at / motion.sample), motion.samples - 1), turns = motion.contact[limb];
  let passed = 0;
  while (passed < turns.length && turns[passed] <= sample) passed++;
  return passed % 2 === 1;
}

function hull(points) {
  const sorted = [...points].sort((p, q) => p[0] - q[0] || p[1] - q[1]);
  const turn = (o, p, q) => (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
  const half = list => list.reduce((kept, p) => {
    while (kept.length > 1 && turn(kept[kept.length - 2], kept[kept.length - 1], p) <= 0) kept.pop();
    kept.push(p);
    return kept;
  }, []);
  return [...half(sorted).slice(0, -1), ...half(sorted.reverse()).slice(0, -1)];
}

function roundStep(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [1, 2, 5, 10].find(head => head * power >= length * (1 - 1e-9));
}

const alike = () => data.limbs.length > 1 && data.limbs.every(limb => limb.colour === "#000000");

/** The points with feet `lift` times as high over their lowest place in the stretch, and joints in proportion. */
function lifted(motion, points) {
  const factor = Number($("lift").value) - 1, raised = [...points];
  let from = 0;
  for (const n of data.figure.limbs) {
    const foot = from + 2 * n - 1, lowest = motion.lowest ??= {};
    lowest[foot] ??= Math.min(...picturesOf(motion).points.map(each => each[foot]));
    for (let j = 1; j < n; j++) raised[from + 2 * j + 1] += factor * (points[foot] - lowest[foot]) * j / (n - 1);
    from += 2 * n;
  }
  return raised;
}

function paintBody(canvas, motion, at, turns) {
  const { pen, width, height } = surface(canvas), look = data.figure;
  const { points: seenPoints, camera } = bodyAt(motion, at, turns), points = lifted(motion, seenPoints);
  const nearEdge = -ASIDE[1] * look.depth, low = nearEdge - 0.24 * look.height, high = 1.2 * look.height;
  const scale = Math.min(height / (high - low), width / (2.3 * look.half));
  const base = height - (height - scale * (high - low)) / 2 + scale * low;
  const place = (x, y) => [width / 2 + x * scale, base - y * scale];
  const thick = Math.max(0.5, Math.min(1.5, look.height * scale / 110));
  const path = list => { pen.beginPath(); list.forEach(([x, y], k) => k ? pen.lineTo(x, y) : pen.moveTo(x, y)); };

  // the ground, its marks, and how far the body has come
  const [, top] = place(0, -nearEdge), [, bottom] = place(0, nearEdge), reach = width / 2 / scale + ASIDE[0] * look.depth;
  pen.fillStyle = shade.strip;
  pen.fillRect(0, top, width, bottom - top);
  const walks = Math.abs(wayOf(motion)) > 1e-3 * look.half;
  const step = roundStep(width / scale / 7), digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  pen.font = "11px system-ui, DejaVu Sans, sans-serif";
  pen.strokeStyle = shade.tick;
  pen.fillStyle = shade.length;
  pen.lineWidth = 1;
  for (let m = Math.ceil((camera - reach) / step); walks && m * step <= camera + reach; m++) {
    const ahead = m * step - camera, near = place(ahead - ASIDE[0] * look.depth, nearEdge);
    path([near, place(ahead + ASIDE[0] * look.depth, -nearEdge)]);
    pen.stroke();
    pen.fillText(`${(m * step + 0).toFixed(digits)} m`.replace("-0 ", "0 "), near[0] + 3, near[1] - 3);
  }

  // points are in the order limbs, bodies, springs
  let from = 0;
  const take = k => { const list = []; for (let j = 0; j < k; j++) list.push(place(points[from + 2 * j], points[from + 2 * j + 1])); from += 2 * k; return list; };
  const limbs = look.limbs.map(take), bodies = look.bodies.map(take);
  const springs = Array.from({ length: look.springs }, () => take(2));
  const sole = 0.05 * look.height * scale, stands = limbs.map((_, k) => down(motion, k, at));
  pen.lineCap = pen.lineJoin = "round";
  limbs.forEach((limb, k) => {
    if (!stands[k]) return;
    const [x, y] = limb[limb.length - 1];
    pen.strokeStyle = shade.bone;
    pen.lineWidth = 2.4 * thick;
    path([[x - sole, y], [x + sole, y]]);
    pen.stroke();
  });
  const drawLimb = k => {
    const limb = limbs[k], colour = alike() && !stands[k] ? seen(SWING) : limbColour(data.limbs[k]);
    pen.strokeStyle = colour;
    pen.lineWidth = 4 * thick;
    path(limb);
    pen.stroke();
    limb.forEach(([x, y], j) => {
      const foot = j === limb.length - 1;
      pen.beginPath();
      pen.arc(x, y, (foot ? 3.8 : 2.9) * thick, 0, TURN);
      pen.fillStyle = foot && stands[k] ? colour : shade.paper;
      pen.lineWidth = 1.6 * thick;
      pen.fill();
      pen.stroke();
    });
  };
  limbs.forEach((_, k) => { if (data.limbs[k].far) drawLimb(k); });
  pen.strokeStyle = shade.bone;
  for (const body of bodies) {
    for (const [part, face] of [[body, shade.body], [body.slice(0, (body.length + 1) >> 1), shade.near]]) {
      path(part.length > 2 ? hull(part) : part);
      pen.closePath();
      pen.fillStyle = face;
      pen.lineWidth = 0.9 * thick;
      pen.fill();
      pen.stroke();
    }
  }
  for (const [a, b] of springs) {
    const along = [b[0] - a[0], b[1] - a[1]], size = Math.hypot(...along) || 1, normal = [-along[1] / size, along[0] / size];
    const zigzag = Array.from({ length: 12 }, (_, k) => {
      const share = k === 0 ? 0 : k === 11 ? 1 : 0.2 + 0.6 * (k - 1) / 10, aside = k > 1 && k < 11 ? 0.6 * sole * (k % 2 ? 1 : -1) : 0;
      return [a[0] + share * along[0] + aside * normal[0], a[1] + share * along[1] + aside * normal[1]];
    });
    pen.lineWidth = 1.1 * thick;
    path(zigzag);
    pen.stroke();
  }
  limbs.forEach((_, k) => { if (!data.limbs[k].far) drawLimb(k); });
  pen.fillStyle = shade.faint;
  pen.textAlign = "right";
  pen.fillText("forward ⟶", width - 6, 14);
  pen.textAlign = "left";
}

/** Save the stretch on view, at the speed on view, as an animated GIF. */
async function saveGif() {
  if (!motion || !picturesOf(motion)) return;  // no body is drawn
  const button = $("save-gif"), speed = clock.speed, length = lengthOf(motion), [, owner] = walkFor(chosen);
  const sides = [[motion, owner], ...(beside ? [[beside, walkFor(other)[1]]] : [])];
  const delay = Math.max(4, Math.ceil(100 * length / speed / MOST_PICTURES));  // hundredths of a second
  const count = Math.max(2, Math.round(100 * length / speed / delay)), steps = sides[0][0].loops ? count : count - 1;
  const whole = document.createElement("canvas"), part = document.createElement("canvas");
  [part.width, part.height] = GIF_SIZE;
  [whole.width, whole.height] = [GIF_SIZE[0] * sides.length, GIF_SIZE[1] + GIF_CAPTION];
  const pen = whole.getContext("2d", { willReadFrequently: true });
  pen.font = "14px system-ui, DejaVu Sans, sans-serif";
  pen.textBaseline = "middle";
  const pixelsOf = k => {
    pen.fillStyle = shade.paper;
    pen.fillRect(0, 0, whole.width, whole.height);
    sides.forEach(([each, i], side) => {
      const at = k / steps * length, left = side * GIF_SIZE[0];
      if (side) paintBeside(part, each, at, at); else paintBody(part, each, at, 0);
      pen.drawImage(part, left, GIF_CAPTION);
      pen.fillStyle = shade.ink;
      pen.fillText(`${data.model}: ${outcomeOf(i).name}; ${plain(titleHtml(i))}`, left + 8, GIF_CAPTION / 2, GIF_SIZE[0] - 16);
    });
    return new Uint32Array(pen.getImageData(0, 0, whole.width, whole.height).data.buffer);
  };
  const name = nameOf(owner), say = text => $("copied").textContent = text;
  button.disabled = true;
  try {
    const delayOf = k => k === count - 1 && !sides[0][0].loops ? 60 : delay;
    const file = await gifOf(whole.width, whole.height, count, pixelsOf, delayOf, k => say(`GIF: picture ${k + 1} of ${count}`));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(file);
    link.download = `${data.name}_${name.replace(/[^0-9a-z]+/gi, "_")}.gif`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    $("live").textContent = say(`GIF of ${name} saved, ${(file.size / 1e6).toFixed(1)} MB`);
  } finally { button.disabled = false; }
}

// ------------------------------------------------------------------------------- footfalls

function paintFootfalls(at) {
  const canvas = $("footfalls"), n = data.limbs.length, row = n > 12 ? 9 : 17;
  canvas.style.height = `${n * row + 24}px`;
  const { pen, width } = surface(canvas), length = lengthOf(motion), every = Math.ceil(n / 16);
  pen.font = "12px system-ui, DejaVu Sans, sans-serif";
  const left = Math.max(...data.limbs.map(limb => pen.measureText(limb.name).width)) + 12, right = width - 8;
  const x = t => left + (right - left) * t / length;
  data.limbs.forEach((limb, k) => {
    const y = k * row + 2;
    if (k % every === 0) {
      pen.fillStyle = shade.ink;
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      pen.fillText(limb.name, left - 8, y + row / 2 - 1);
    }
    pen.fillStyle = shade.bar;
    pen.fillRect(left, y, right - left, row - 4);
    pen.fillStyle = limbColour(limb);
    const turns = motion.contact[k];
    for (let j = 0; j + 1 < turns.length; j += 2) {
      const begin = x(Math.max(0, (turns[j] - 0.5) * motion.sample)), end = x(Math.min(length, (turns[j + 1] - 0.5) * motion.sample));
      pen.fillRect(begin, y, end - begin, row - 4);
    }
  });
  if (alike()) paintWave(pen, x, row);
  const below = n * row + 2;
  pen.strokeStyle = pen.fillStyle = shade.faint;
  pen.textAlign = "center";
  pen.textBaseline = "top";
  const step = roundStep(length / 5), digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  for (let m = Math.ceil(motion.begin / step); m * step <= motion.begin + length + 1e-9; m++) {
    const place = x(m * step - motion.begin);
    pen.beginPath();
    pen.moveTo(place, below - 2);
    pen.lineTo(place, below + 2);
    pen.stroke();
    if (place < right - 20) pen.fillText(`${(m * step).toFixed(digits)}`, place, below + 5);
  }
  pen.textAlign = "right";
  pen.fillText("s", right, below + 5);
  pen.strokeStyle = shade.mark;
  pen.lineWidth = 1.4;
  pen.beginPath();
  pen.moveTo(x(at), 0);
  pen.lineTo(x(at), below);
  pen.stroke();
}

/** The wave of swings: lines from the instants at which a leg lifts to the nearest ones of the next leg. */
function paintWave(pen, x, row) {
  const lifts = motion.contact.map(turns => turns.filter((at, j) => j % 2 && at < motion.samples)), half = data.cycle / 2 / motion.sample;
  pen.strokeStyle = seen(SWING);
  pen.lineWidth = 1.6;
  pen.beginPath();
  lifts.slice(1).forEach((next, k) => lifts[k].forEach(at => {
    const nearest = next.reduce((best, each) => Math.abs(each - at) < Math.abs(best - at) ? each : best, Infinity);
    if (Math.abs(nearest - at) >= half) return;
    pen.moveTo(x(at * motion.sample), (k + 0.5) * row);
    pen.lineTo(x(nearest * motion.sample), (k + 1.5) * row);
  }));
  pen.stroke();
}

// ------------------------------------------------------------------------------- phases

/** The largest multiplier along a branch, for tables that have one. */
function showMultipliers() {
  const line = { x: [], y: [] }, mine = recordsOf.get(raw(columns.row, chosen)).filter(i => branchOf(i) === branchOf(chosen));
  for (const i of mine) { line.x.push(numberAt(data.x.name, i)); line.y.push(numberAt("multiplier", i)); }
  const at = numberAt(data.x.name, chosen), range = ranges()[0], box = $("phases");
  $("phases-title").textContent = "Largest multiplier along the branch: the gait is stable below 1";
  const [lines, points] = [{ mode: "lines", ...line, line: { color: SERIES[1], width: 1.8 } },
    { mode: "markers", x: [at], y: [numberAt("multiplier", chosen)], marker: { size: 11, color: SERIES[1], line: { width: 2, color: shade.mark } } }];
  Plotly.react(box, [lines, points].map(each => ({ type: "scatter", hovertemplate: "%{x:.5g}: %{y:.5g}<extra></extra>", ...each })), {
    ...figureLayout(12), width: box.clientWidth, height: box.clientHeight, margin: { l: 52, r: 8, t: 8, b: 42 }, showlegend: false,
    xaxis: { title: { text: data.x.label, standoff: 4 }, type: data.x.log ? "log" : "linear", range, zeroline: false, gridcolor: shade.grid }, dragmode: false,
    yaxis: { title: { text: "modulus" }, rangemode: "tozero", gridcolor: shade.grid },
    shapes: [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { dash: "dot", width: 1.2, color: shade.faint } }] }, { ...NO_UPLOAD, displayModeBar: false });
}

let group = 0;                                    // of observables, that is drawn over the cycles

/** The choice between groups of observables, where there are several. */
function showGroups(there) {
  const names = [...new Set(data.series.map(each => each.group))];
  $("groups").hidden = !there || names.length < 2;
  $("groups").replaceChildren(...names.map((name, k) => {
    const button = document.createElement("button");
    button.type = "button";
    button.innerHTML = name;
    button.setAttribute("aria-pressed", k === group);
    button.onclick = () => { group = k; showPhases(); $("groups").children[k].focus(); };
    return button;
  }));
  return names[group];
}

function showPhases() {
  const box = $("phases"), there = walk && data.series.length && walk.crossings.values.length;
  if (columns.multiplier) { if (window.Plotly) showMultipliers(); return; }
  box.style.display = $("phases-title").style.display = there ? "" : "none";
  const name = showGroups(there);
  if (!there || !window.Plotly) return;
  const drawn = data.series.map((_, s) => s).filter(s => data.series[s].group === name), angles = data.series[drawn[0]].circular;
  $("phases-title").textContent = angles ? "Relative phases at each crossing of the section" : "Observables at each crossing of the section";
  const found = seriesOf(walk), first = walk.crossings.first, traces = [];
  drawn.forEach((s, place) => {
    const series = data.series[s], values = found[s], x = [], y = [];
    let before = null;
    values.forEach((value, k) => {
      const shown = value === null ? null : series.circular ? mod(value, TURN) : value;
      // a line between both ends of the circle would show a change that is none
      if (series.circular && shown !== null && before !== null && Math.abs(shown - before) > Math.PI) { x.push(null); y.push(null); }
      x.push(first + k);
      y.push(shown);
      before = shown;
    });
    traces.push({ type: "scatter", mode: values.length > 80 && data.run !== "return_map" ? "lines" : "lines+markers", x, y, name: series.symbol, marker: { size: 4 },
      line: { color: SERIES[place % SERIES.length], width: 1.8 },
      hovertemplate: `${series.symbol}, cycle %{x}: ${series.circular ? "%{y:.4f} rad" : "%{y:.5g} " + escaped(series.unit)}<extra></extra>` });
  });
  const yaxis = angles ? { range: [-0.1, TURN + 0.1], ...piTicks(0, TURN) } : { title: { text: escaped(data.series[drawn[0]].unit) } };
  const shapes = data.run === "return_map" ? [{ type: "line", yref: "paper", y0: 0, y1: 1, x0: numberAt("crossing", chosen), x1: numberAt("crossing", chosen), line: { width: 1.4, color: shade.ink } }] : [];
  // of a long map the cycles around the chosen one
  const at = data.run === "return_map" ? numberAt("crossing", chosen) : NaN, whole = [first, first + found[drawn[0]].length - 1];
  const range = whole[1] - whole[0] > 4 * AROUND && Number.isFinite(at) ? [Math.max(at - AROUND, whole[0]), Math.min(at + AROUND, whole[1])] : undefined;
  Plotly.react(box, traces, { ...figureLayout(12), width: box.clientWidth, height: box.clientHeight, margin: { l: 52, r: 8, t: 8, b: 38 }, shapes,
    xaxis: { title: { text: "cycle", standoff: 4 }, range, autorange: range === undefined, zeroline: false, gridcolor: shade.grid }, yaxis: { zeroline: false, gridcolor: shade.grid, automargin: true, ...yaxis },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, showlegend: true, dragmode: false }, { ...NO_UPLOAD, displayModeBar: false });
}

// ------------------------------------------------------------------------------- slices, legend, keys

function showSlices() {
  $("slices").replaceChildren(...data.slices.map((each, k) => {
    const several = each.texts.length > 5, label = document.createElement(several ? "label" : "fieldset");
    const pick = value => {
      const before = slice;
      slice = slice.map((old, j) => j === k ? value : old);
      const key = shownKey(), at = data.kind === "cells" ? cellKey(chosen) : null;
      let next = at !== null && recordAt.has(`${key}|${at}`) ? recordAt.get(`${key}|${at}`) : -1;
      for (let i = 0; i < count && next < 0; i++) if (sliceKey(i) === key) next = i;
      if (next < 0) {  // of a table that is not complete
        slice = before;
        showSlices();
        $("live").textContent = $("elsewhere").textContent = `No row with ${plain(each.texts[value])} has ended yet.`;
      } else {
        slice = [];
        choose(next);
      }
      const again = $("slices").children[k];
      (again.querySelector("select") || again.children[value]).focus();
    };
    if (several) {
      const select = document.createElement("select");
      each.texts.forEach((text, value) => select.add(new Option(plain(text), value, false, slice[k] === value)));
      select.onchange = () => pick(Number(select.value));
      label.append(plain(each.name), select);
    } else each.texts.forEach((text, value) => {
      const button = document.createElement("button");
      button.type = "button";
      button.innerHTML = text;
      button.setAttribute("aria-pressed", slice[k] === value);
      button.onclick = () => pick(value);
      label.append(button);
    });
    return label;
  }));
}

function showLegend() {
  const shares = data.outcomes.map(() => 0), key = shownKey();
  let all = 0;
  for (let i = 0; i < count; i++) if (sliceKey(i) === key) { shares[data.outcome[i]]++; all++; }
  $("legend").replaceChildren(...data.outcomes.map((outcome, k) => {
    const item = document.createElement("li"), share = 100 * shares[k] / all;
    item.append(chip(outcome), `${outcome.name} ${share > 0 && share < 0.5 ? "<1" : share.toFixed(0)} %`);
    return item;
  }));
  for (const rises of data.passes.length ? [true, false] : []) {
    const item = document.createElement("li"), pass = data.passes.find(each => each.rises === rises), sign = document.createElement("span");
    sign.textContent = rises ? "▲" : "▼";
    item.append(sign, ` ${passText(pass)}, line ${rises ? "solid" : "dashed"}`);
    $("legend").append(item);
  }
  if (columns.stable) {
    const item = document.createElement("li");
    item.textContent = "branch solid where stable, dashed where unstable";
    $("legend").append(item);
  }
}

const cellKey = i => `${data.at[0][i]},${data.at[1][i]}`;

/** The record one step along an axis from the chosen one. */
function neighbour(dx, dy) {
  if (data.kind === "cells") {
    const at = [data.at[0][chosen], data.at[1][chosen]], step = [dx, dy];
    const lengths = data.edges.map(edges => edges.length - 1);
    for (let tries = 0; tries < Math.max(...lengths); tries++) {
      for (const k of [0, 1]) {
        at[k] += step[k];
        if (data.closed[k]) at[k] = mod(at[k], lengths[k]);
        if (at[k] < 0 || at[k] >= lengths[k]) return chosen;
      }
      const found = recordAt.get(`${shownKey()}|${at}`);
      if (found !== undefined) return found;
    }
    return chosen;
  }
  const row = raw(columns.row, chosen), mine = recordsOf.get(row);
  if (dx && mine.length > 1) return mine[Math.min(Math.max(mine.indexOf(chosen) + dx, 0), mine.length - 1)];
  const rows = [...recordsOf.keys()].filter(each => sliceKey(recordsOf.get(each)[0]) === sliceKey(chosen));
  const next = rows[Math.min(Math.max(rows.indexOf(row) + (dy || dx), 0), rows.length - 1)];
  const theirs = recordsOf.get(next);
  return theirs[Math.min(mine.indexOf(chosen), theirs.length - 1)];
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };

function pressed(event) {
  const typing = ["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName);
  if (event.ctrlKey || event.metaKey || event.altKey || typing) return;
  if (event.key === " " && event.target.tagName !== "BUTTON") play(!clock.playing);
  else if (ARROWS[event.key] && (event.target === $("map") || event.target === document.body || event.target.tagName === "BUTTON")) choose(neighbour(...ARROWS[event.key]));
  else if (event.key === "e" && other >= 0) choose(other);
  else return;
  event.preventDefault();
}

function fromHash() {
  const found = /^#row=(\d+)(?:,(\d+))?$/.exec(location.hash);
  const records = found && recordsOf.get(Number(found[1]));
  return records ? records[Math.min(Number(found[2] || 0), records.length - 1)] : -1;
}

// ------------------------------------------------------------------------------- beginning

function showAbout() {
  document.title = `${data.name}: explorer`;
  $("about").textContent = `${data.model}${data.what ? ": " + data.what : ""} ${data.source ? "(" + data.source + ") " : ""}${data.rows} row${data.rows === 1 ? "" : "s"}, run of kind ${data.run}.`;
  $("remarks").textContent = data.remarks.join("; ");
  $("remarks").hidden = !data.remarks.length;
  $("map-title").textContent = data.kind === "cells" ? "Outcome of each start: choose one" : "Choose a point";
  $("map").setAttribute("aria-label", `map of ${count} records over ${plain(data.x.label)} and ${plain(data.y.label)}; arrow keys move from one to the next`);
  const arrows = data.kind === "cells" ? "<kbd>←</kbd> <kbd>→</kbd> <kbd>↑</kbd> <kbd>↓</kbd> move"
    : "<kbd>←</kbd> <kbd>→</kbd> move along a row, <kbd>↑</kbd> <kbd>↓</kbd> to another row";
  const playing = data.walks.length ? " <kbd>space</kbd> plays and pauses," : "";
  $("keys").innerHTML = `${arrows},${playing} <kbd>e</kbd> goes to the nearest that leads elsewhere.`;
  const from = data.provenance;
  $("provenance").textContent = `gaitsweep ${from.gaitsweep}; job ${from.job}${from.commit ? ", commit " + from.commit : ""}; ${from.engine}, ${from.device}.`;
  if (!data.figure && data.walks.length) $("told").append(` ${data.model} defines no skeleton, so only its observables are shown.`);
  else if (data.figure && data.figure.note) $("told").append(` ${data.figure.note}`);
}

function fillSpeeds() {
  const usual = data.cycle / CYCLE_SECONDS;
  const speeds = [0.02, 0.05, 0.1, 0.2, 0.4, 1, 2, 5].map(speed => [speed, speed === 1 ? "real time" : speed < 1 ? `${1 / speed} times slower` : `${speed} times faster`]);
  const best = speeds.reduce((a, b) => Math.abs(Math.log(b[0] / usual)) < Math.abs(Math.log(a[0] / usual)) ? b : a);
  for (const [speed, text] of speeds) $("speed").add(new Option(text, speed, false, speed === best[0]));
  clock.speed = best[0];
  for (const times of [1, 2, 3, 5]) $("lift").add(new Option(times === 1 ? "lift as it is" : `lift ${times} times as high`, times));
  $("lift").onchange = paint;
  $("lift").hidden = !data.figure || !data.figure.limbs.length;
  $("speed").onchange = () => clock.speed = Number($("speed").value);
}

/** Read plotly.js, which takes longer than all else: the page shows what it can before. */
async function readPlotly(source) {
  const script = document.createElement("script");
  script.textContent = await source;
  document.head.append(script);
  if (!window.Plotly) throw new Error("plotly.js could not be read.");
}

async function begin() {
  if (typeof DecompressionStream === "undefined") throw new Error("This browser is older than 2023 and cannot unpack the page.");
  data = JSON.parse(await unpacked("data"));
  data.columns.forEach(each => columns[each.name] = each);
  count = data.outcome.length;
  data.walks.forEach(each => walkOf.set(each.record, each));
  for (let i = 0; i < count; i++) {
    const row = raw(columns.row, i);
    if (!recordsOf.has(row)) recordsOf.set(row, []);
    recordsOf.get(row).push(i);
    if (data.kind === "cells") recordAt.set(`${sliceKey(i)}|${cellKey(i)}`, i);
  }
  spans = ranges().map(([low, high]) => high - low);
  $("wait").remove();
  document.querySelector("main").hidden = false;
  showAbout();
  fillSpeeds();
  const linked = fromHash(), first = linked >= 0 ? linked : data.first;
  slice = data.slices.map(each => each.of[first]);
  showSlices();
  showLegend();
  sketchMap();
  choose(first, { announce: false });
  $("compare").onclick = event => {
    event.currentTarget.setAttribute("aria-pressed", event.currentTarget.getAttribute("aria-pressed") !== "true");
    showBeside();
    paint();
  };
  $("copy-link").onclick = () => copy(location.href, "Link");
  $("copy-python").onclick = () => copy(pythonOf(chosen), "Python");
  $("save-gif").onclick = saveGif;
  $("play").onclick = () => play(!clock.playing);
  $("time").oninput = () => { play(false); clock.at = Number($("time").value) / 1000 * lengthOf(motion); paint(); };
  addEventListener("keydown", pressed);
  addEventListener("hashchange", () => { const i = fromHash(); if (i >= 0 && i !== chosen) choose(i); });
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; drawMap(); showPhases(); } paint(); });
  darkness.addEventListener("change", () => {
    shade = SCHEMES[darkness.matches ? "dark" : "light"];
    showLegend(); drawMap(); showRecord(); showPhases(); paint();
  });
  const source = unpacked("plotly");
  await painted();
  const shown = performance.now();
  await readPlotly(source);
  await drawMap();
  if (data.kind === "cells" && $("map")._fullData[0].type !== "heatmap") throw new Error("plotly.js draws no cells.");
  $("map").on("plotly_click", event => {
    const point = event.points[0];
    if (point.data.type !== "heatmap") { if (point.customdata !== undefined) choose(point.customdata); return; }
    const [b, a] = point.pointIndex ?? point.pointNumber, found = recordAt.get(`${shownKey()}|${a},${b}`);
    if (found !== undefined) choose(found);
    $("map").focus({ preventScroll: true });
  });
  const opened = performance.now();
  await painted();
  showPhases();
  play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  requestAnimationFrame(tick);
  $("provenance").append(` Shown ${(shown / 1000).toFixed(2)} s after it was opened, its map ready after ${(opened / 1000).toFixed(2)} s.`);
  document.documentElement.dataset.shown = Math.round(shown);
  document.documentElement.dataset.ready = Math.round(opened);
}

begin().catch(error => {
  const wait = $("wait") || document.body.appendChild(document.createElement("p"));
  wait.className = "warning";
  wait.textContent = `The page could not be shown: ${error.message}`;
});
