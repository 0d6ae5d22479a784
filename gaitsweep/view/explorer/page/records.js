// The records of the table, and their values as text.

let data, count;                                  // the page's fields, and the number of its records
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

const outcomeOf = i => data.outcomes[data.outcome[i]];
const sliceKey = i => data.slices.map(axis => axis.of[i]).join(",");
/** The branch of a record, in an atlas, whose rows have several. */
const branchOf = i => data.run === "atlas" ? raw(columns.number, i) : 0;
const shownKey = () => slice.join(",");
/** The records of a record's row. */
const rowOf = i => recordsOf.get(raw(columns.row, i));
const nameOf = i => {
  const row = raw(columns.row, i), records = rowOf(i);
  return records.length > 1 ? `row ${row}, record ${records.indexOf(i) + 1} of ${records.length}` : `row ${row}`;
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

/** An angle (rad) as a multiple of pi: 3π/4, or 0.77π if it is not a simple fraction. */
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

const cellKey = i => `${data.at[0][i]},${data.at[1][i]}`;
