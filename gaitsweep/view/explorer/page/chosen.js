// The chosen record: its values, its outcome, and links to it.

// What a record is beside another of another gait, for kinds whose rows have several gaits.
const ELSEWHERE = { staircase: "Nearest stair with another gait", ramp: "Nearest crossing with another gait",
  continuation: "Nearest point of another gait", atlas: "Nearest point of another gait" };

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

function hashOf(i) {
  const row = raw(columns.row, i), mine = recordsOf.get(row);
  return mine.length > 1 ? `#row=${row},${mine.indexOf(i)}` : `#row=${row}`;
}

function fromHash() {
  const found = /^#row=(\d+)(?:,(\d+))?$/.exec(location.hash);
  const records = found && recordsOf.get(Number(found[1]));
  return records ? records[Math.min(Number(found[2] || 0), records.length - 1)] : -1;
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
