// Observables over the cycles of a walk, or multipliers along a branch.

const AROUND = 40;                              // cycles on both sides of the chosen one, of a long map

const SERIES = ["#E69F00", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#56B4E9"];

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
