// The map: cells or points by plotly.js, with marks of the chosen record and the nearest other one.

/** Ticks at round multiples of pi, at most seven. */
function piTicks(low, high) {
  const steps = [0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1].map(share => share * Math.PI);
  const step = steps.find(width => (high - low) / width <= 6) ?? Math.PI, values = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9; k++) values.push(k * step);
  return { tickvals: values, ticktext: values.map(inPi) };
}

/** The place of a value along an axis: its logarithm to base 10 if the axis is logarithmic. */
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
  color: visible(outcome.colour), line: { width: outcome.hollow ? 1.6 : 0.5, color: outcome.hollow ? visible(outcome.colour) : shade.edge } });

function hoverText(i) {
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
    text[b][a] = hoverText(i);
    for (const [dots, isMarked] of [[hatched, outcomeOf(i).hatched], [walking, walkOf.has(i)]]) {
      if (isMarked) { dots.x.push(centre[0]); dots.y.push(centre[1]); }
    }
  }
  const scale = [];
  data.outcomes.forEach((outcome, k) => scale.push(...[k, k + 1].map(end => [end / (last + 1), visible(outcome.colour)])));
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
  if (data.passes.length) return { width: 1.2, color: visible(passOf(j).colour), dash: passOf(j).rises ? "solid" : "dash" };
  if (!columns.stable) return { width: 0.8, color: shade.trail };
  // a bifurcation is on the border of both, and a kink of the map is no part of a branch
  const special = k => textOf(columns.special, k);
  if (special(j) === "kink") return { width: 1, color: shade.trail, dash: "dot" };
  return { width: 1.8, color: shade.bone, dash: outcomeOf(special(i) ? j : i).hollow ? "dash" : "solid" };
}

/** The lines between consecutive records of rows, one trace for each style. */
function lineTraces() {
  const key = shownKey(), lines = new Map();  // pieces by their style
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
  return [...lines.values()];
}

/** The line of a return map on which the value does not change. */
function noChangeTraces() {
  if (data.noChange === null) return [];
  const range = ranges()[0].map(at => offScale(data.x, at)), line = { width: 1, dash: "dot", color: shade.axis };
  return [{ type: "scatter", mode: "lines", x: range, y: range.map(at => data.noChange * at), line, hoverinfo: "skip" }];
}

function sizeOfPoints() {
  if (count > 1500) return 4;
  return count > 400 ? 6 : 8;
}

function pointTraces() {
  const traces = [...lineTraces(), ...noChangeTraces()], key = shownKey(), size = sizeOfPoints();
  data.outcomes.forEach((outcome, number) => {
    const look = marker(outcome, size), symbol = data.passes.length ? [] : look.symbol;
    const trace = { type: "scatter", mode: "markers", x: [], y: [], customdata: [], text: [], hovertemplate: "%{text}<extra></extra>", marker: { ...look, symbol } };
    for (let i = 0; i < count; i++) {
      if (data.outcome[i] !== number || sliceKey(i) !== key) continue;
      trace.x.push(along(data.x, numberAt(data.x.name, i)));
      trace.y.push(along(data.y, numberAt(data.y.name, i)));
      trace.customdata.push(i);
      trace.text.push(hoverText(i));
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
    pen.fillStyle = visible(outcomeOf(i).colour);
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
