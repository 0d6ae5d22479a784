// The chosen record: its values, its outcome, and links to it.

// Names of the nearest record with another gait, for run kinds whose rows have several gaits.
const ELSEWHERE = { staircase: "Nearest stair with another gait", ramp: "Nearest crossing with another gait",
  continuation: "Nearest point of another gait", atlas: "Nearest point of another gait" };

/** Show a record; `announce`: read it out to users of a screen reader. */
function choose(i, { announce = true } = {}) {
  if (!(i >= 0 && i < count)) return;
  chosen = i;
  const before = shownKey();
  slice = data.slices.map(axis => axis.of[i]);
  other = nearest(i, j => outcomeOf(j).leads !== outcomeOf(i).leads);
  if (shownKey() !== before) { showSlices(); drawMap(); showLegend(); } else if ($("map").layout) Plotly.relayout("map", { shapes: marks() });
  const hash = hashOf(i);
  if (location.hash !== hash) history.replaceState(null, "", hash);
  showRecord();
  showWalk();
  if (announce) $("live").textContent = `${nameOf(i)}: ${plain(data.x.label)} ${valueText(data.x.name, i)}, `
    + `${plain(data.y.label)} ${valueText(data.y.name, i)}, ${outcomeOf(i).name}`;
}

/** A record's name, its place on the map and its slices. */
function titleHtml(i) {
  const coordinates = [data.x, data.y].map(axis => `${columns[axis.name].symbol} = ${escaped(valueText(axis.name, i))}`);
  return [`${nameOf(i)}: ${coordinates.join(", ")}`, ...data.slices.map(axis => axis.texts[axis.of[i]])].join("; ");
}

/** Show the values of the chosen record, its outcome, and the way to another one. */
function showRecord() {
  $("chosen").innerHTML = titleHtml(chosen);
  showEnd(chosen);
  showElsewhere(chosen);
  $("record").tBodies[0].replaceChildren(...data.columns.map(column => valueLine(column, chosen)));
}

/** Show the outcome of a record, and how its row ended. */
function showEnd(i) {
  const outcome = outcomeOf(i), status = textOf(columns.status, i);
  const period = status === "settled" && columns.attractor_period ? numberAt("attractor_period", i) : NaN;
  const repeats = period === 1 ? "at a fixed point" : `on an orbit of ${period} crossings`;
  const sentence = period > 0 ? `The state at the section repeats ${repeats}.` : data.statuses[status];
  const subject = rowOf(i).length > 1 ? "the whole row: " : "";
  $("ended").replaceChildren(chip(outcome), outcome.name);
  if (data.passes.length) $("ended").append(`; ${passText(passOf(i))}`);
  $("ended").append(`; ${subject}${status}${sentence ? ": " + sentence : ""}`);
}

/** Show a link to the nearest record that leads elsewhere. */
function showElsewhere(i) {
  const box = $("elsewhere");
  box.replaceChildren();
  if (other < 0) {
    box.textContent = "All records shown here have the same gait.";
    return;
  }
  const link = document.createElement("a"), target = outcomeOf(other);
  link.href = hashOf(other);
  link.append(chip(target), `${target.name} (${nameOf(other)})`);
  const apart = distance(i, other);
  const far = data.kind === "cells" ? `, ${Number(apart.toPrecision(3))} cell${apart === 1 ? "" : "s"} away` : "";
  box.append(`${ELSEWHERE[data.run] || "Nearest start with another outcome"}: `, link, far + ".");
}

/** A line of the table of a record: the column's symbol and name, its value, and its meaning. */
function valueLine(column, i) {
  const line = document.createElement("tr"), head = document.createElement("th");
  const value = document.createElement("td"), meaning = document.createElement("td");
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
  const angle = column.circular && Number.isFinite(numberAt(column.name, i)) ? inPi(numberAt(column.name, i)) : "";
  meaning.textContent = [angle, column.meaning].filter(Boolean).join("; ");
  line.append(head, value, meaning);
  return line;
}

/** The part of an address that names a record. */
function hashOf(i) {
  const row = raw(columns.row, i), records = rowOf(i);
  return records.length > 1 ? `#row=${row},${records.indexOf(i)}` : `#row=${row}`;
}

/** The record that the page's address names; -1 without one. */
function fromHash() {
  const match = /^#row=(\d+)(?:,(\d+))?$/.exec(location.hash);
  const records = match && recordsOf.get(Number(match[1]));
  return records ? records[Math.min(Number(match[2] || 0), records.length - 1)] : -1;
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
