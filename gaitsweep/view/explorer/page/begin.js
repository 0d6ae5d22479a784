// The keys, what the page says of the table, and its beginning.

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };

function onKey(event) {
  const typing = ["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName);
  if (event.ctrlKey || event.metaKey || event.altKey || typing) return;
  if (event.key === " " && event.target.tagName !== "BUTTON") play(!clock.playing);
  else if (ARROWS[event.key] && (event.target === $("map") || event.target === document.body || event.target.tagName === "BUTTON")) choose(neighbour(...ARROWS[event.key]));
  else if (event.key === "e" && other >= 0) choose(other);
  else return;
  event.preventDefault();
}

const painted = () => new Promise(done => requestAnimationFrame(() => setTimeout(done, 0)));

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
  addEventListener("keydown", onKey);
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
