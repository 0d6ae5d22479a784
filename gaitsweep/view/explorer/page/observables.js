// Figures beside the map: observables over the cycles of a walk, or multipliers along a branch.

const AROUND = 40;                              // cycles on both sides of the chosen one, of a long map

const SERIES = ["#E69F00", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#56B4E9"];

/** The largest multiplier along a branch, for tables that have one. */
function showMultipliers() {
  const branch = rowOf(chosen).filter(i => branchOf(i) === branchOf(chosen));
  const line = { x: branch.map(i => numberAt(data.x.name, i)), y: branch.map(i => numberAt("multiplier", i)) };
  const at = numberAt(data.x.name, chosen), range = ranges()[0], box = $("phases");
  $("phases-title").textContent = "Largest multiplier along the branch: the gait is stable below 1";
  const [lines, points] = [{ mode: "lines", ...line, line: { color: SERIES[1], width: 1.8 } },
    { mode: "markers", x: [at], y: [numberAt("multiplier", chosen)], marker: { size: 11, color: SERIES[1], line: { width: 2, color: shade.mark } } }];
  Plotly.react(box, [lines, points].map(trace => ({ type: "scatter", hovertemplate: "%{x:.5g}: %{y:.5g}<extra></extra>", ...trace })), {
    ...figureLayout(12), width: box.clientWidth, height: box.clientHeight, margin: { l: 52, r: 8, t: 8, b: 42 }, showlegend: false,
    xaxis: { title: { text: data.x.label, standoff: 4 }, type: data.x.log ? "log" : "linear", range, zeroline: false, gridcolor: shade.grid }, dragmode: false,
    yaxis: { title: { text: "modulus" }, rangemode: "tozero", gridcolor: shade.grid },
    shapes: [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { dash: "dot", width: 1.2, color: shade.faint } }] }, { ...NO_UPLOAD, displayModeBar: false });
}

let group = 0;                                    // of observables, that is drawn over the cycles

/** Show the choice between groups of observables, if there are several; returns the name of the chosen one. */
function showGroups(drawn) {
  const names = [...new Set(data.series.map(series => series.group))];
  $("groups").hidden = !drawn || names.length < 2;
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

/** The trace of an observable from its values at the crossings from number `first` on. */
function crossingTrace(series, values, first, color) {
  const x = [], y = [];
  let before = null;
  values.forEach((value, k) => {
    const shown = value !== null && series.circular ? mod(value, TURN) : value;
    // a line between both ends of the circle would show a change that is none
    if (series.circular && shown !== null && before !== null && Math.abs(shown - before) > Math.PI) { x.push(null); y.push(null); }
    x.push(first + k);
    y.push(shown);
    before = shown;
  });
  const withPoints = values.length <= 80 || data.run === "return_map";
  const number = series.circular ? "%{y:.4f} rad" : "%{y:.5g} " + escaped(series.unit);
  return { type: "scatter", mode: withPoints ? "lines+markers" : "lines", x, y, name: series.symbol, marker: { size: 4 },
    line: { color, width: 1.8 }, hovertemplate: `${series.symbol}, cycle %{x}: ${number}<extra></extra>` };
}

/** The line at the chosen crossing of a return map, and the cycles around it if the map is long. */
function crossingMark(first, last) {
  if (data.run !== "return_map") return { shapes: [], range: undefined };
  const at = numberAt("crossing", chosen), long = last - first > 4 * AROUND && Number.isFinite(at);
  return { shapes: [{ type: "line", yref: "paper", y0: 0, y1: 1, x0: at, x1: at, line: { width: 1.4, color: shade.ink } }],
    range: long ? [Math.max(at - AROUND, first), Math.min(at + AROUND, last)] : undefined };
}

/** Draw the observables of the walk on view over its cycles. */
function showPhases() {
  if (columns.multiplier) { if (window.Plotly) showMultipliers(); return; }
  const box = $("phases"), drawn = walk && data.series.length && walk.crossings.values.length;
  box.style.display = $("phases-title").style.display = drawn ? "" : "none";
  const name = showGroups(drawn);
  if (!drawn || !window.Plotly) return;
  const values = seriesOf(walk), first = walk.crossings.first, last = first + values[0].length - 1;
  const shown = data.series.map((_, s) => s).filter(s => data.series[s].group === name), { circular, unit } = data.series[shown[0]];
  $("phases-title").textContent = circular ? "Relative phases at each crossing of the section" : "Observables at each crossing of the section";
  const traces = shown.map((s, place) => crossingTrace(data.series[s], values[s], first, SERIES[place % SERIES.length]));
  const yaxis = circular ? { range: [-0.1, TURN + 0.1], ...piTicks(0, TURN) } : { title: { text: escaped(unit) } };
  const { shapes, range } = crossingMark(first, last);
  Plotly.react(box, traces, { ...figureLayout(12), width: box.clientWidth, height: box.clientHeight, margin: { l: 52, r: 8, t: 8, b: 38 }, shapes,
    xaxis: { title: { text: "cycle", standoff: 4 }, range, autorange: range === undefined, zeroline: false, gridcolor: shade.grid }, yaxis: { zeroline: false, gridcolor: shade.grid, automargin: true, ...yaxis },
    legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, showlegend: true, dragmode: false }, { ...NO_UPLOAD, displayModeBar: false });
}
