// The keys, the texts about the table, and the beginning of the page.

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };

function onKey(event) {
  const { key, target } = event, onButton = target.tagName === "BUTTON";
  const typing = ["INPUT", "SELECT", "TEXTAREA"].includes(target.tagName);
  if (event.ctrlKey || event.metaKey || event.altKey || typing) return;
  const moving = ARROWS[key] && (onButton || target === $("map") || target === document.body);
  if (key === " " && !onButton) play(!clock.playing);
  else if (moving) choose(neighbour(...ARROWS[key]));
  else if (key === "e" && other >= 0) choose(other);
  else return;
  event.preventDefault();
}

/** Wait until the browser has painted the page. */
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
  const { gaitsweep, job, commit, engine, device } = data.provenance;
  $("provenance").textContent = `gaitsweep ${gaitsweep}; job ${job}${commit ? ", commit " + commit : ""}; ${engine}, ${device}.`;
  if (!data.figure && data.walks.length) $("contents").append(` ${data.model} defines no skeleton, so only its observables are shown.`);
  else if (data.figure && data.figure.note) $("contents").append(` ${data.figure.note}`);
}

/** Read plotly.js, which takes so long that the page shows a sketch of the map meanwhile. */
async function readPlotly(source) {
  const script = document.createElement("script");
  script.textContent = await source;
  document.head.append(script);
  if (!window.Plotly) throw new Error("plotly.js could not be read.");
}

/** Read the records, and number them by row and by cell. */
async function readData() {
  data = JSON.parse(await unpacked("data"));
  for (const column of data.columns) columns[column.name] = column;
  count = data.outcome.length;
  for (const replay of data.walks) walkOf.set(replay.record, replay);
  for (let i = 0; i < count; i++) {
    const row = raw(columns.row, i);
    if (!recordsOf.has(row)) recordsOf.set(row, []);
    recordsOf.get(row).push(i);
    if (data.kind === "cells") recordAt.set(`${sliceKey(i)}|${cellKey(i)}`, i);
  }
  spans = ranges().map(([low, high]) => high - low);
}

/** Show the page, with a sketch of the map, and the record of its address. */
function showPage() {
  $("wait").remove();
  document.querySelector("main").hidden = false;
  showAbout();
  fillSpeeds();
  fillLifts();
  const linked = fromHash(), first = linked >= 0 ? linked : data.first;
  slice = data.slices.map(axis => axis.of[first]);
  showSlices();
  showLegend();
  sketchMap();
  choose(first, { announce: false });
}

function toggleBeside(event) {
  const button = event.currentTarget, pressed = button.getAttribute("aria-pressed") === "true";
  button.setAttribute("aria-pressed", !pressed);
  showBeside();
  paint();
}

/** Answer buttons, keys, links, and changes of the window and of the colour scheme. */
function listen() {
  $("compare").onclick = toggleBeside;
  $("copy-link").onclick = () => copy(location.href, "Link");
  $("copy-python").onclick = () => copy(pythonOf(chosen), "Python");
  $("save-gif").onclick = saveGif;
  $("play").onclick = () => play(!clock.playing);
  $("time").oninput = () => { play(false); clock.at = Number($("time").value) / 1000 * lengthOf(motion); paint(); };
  addEventListener("keydown", onKey);
  addEventListener("hashchange", () => { const i = fromHash(); if (i >= 0 && i !== chosen) choose(i); });
  let width = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth !== width) { width = innerWidth; drawMap(); showPhases(); }
    paint();
  });
  darkness.addEventListener("change", () => {
    shade = SCHEMES[darkness.matches ? "dark" : "light"];
    showLegend(); drawMap(); showRecord(); showPhases(); paint();
  });
}

/** Choose the record at a place of the map that was clicked. */
function onMapClick(event) {
  const point = event.points[0];
  if (point.data.type !== "heatmap") { if (point.customdata !== undefined) choose(point.customdata); return; }
  const [b, a] = point.pointIndex ?? point.pointNumber, record = recordAt.get(`${shownKey()}|${a},${b}`);
  if (record !== undefined) choose(record);
  $("map").focus({ preventScroll: true });
}

async function begin() {
  if (typeof DecompressionStream === "undefined") throw new Error("This browser is older than 2023 and cannot unpack the page.");
  await readData();
  showPage();
  listen();
  const source = unpacked("plotly");
  await painted();
  const shown = performance.now();
  await readPlotly(source);
  await drawMap();
  if (data.kind === "cells" && $("map")._fullData[0].type !== "heatmap") throw new Error("plotly.js draws no cells.");
  $("map").on("plotly_click", onMapClick);
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
