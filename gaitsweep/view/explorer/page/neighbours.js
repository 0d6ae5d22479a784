// Distances between records, the nearest one with a property, and the next one along an axis.

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

let spans = [1, 1];                               // of both axes

/** The nearest record in a record's slice for which `fits` is true; -1 without one. */
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

/** The record one step along an axis from the chosen one. */
const neighbour = (dx, dy) => data.kind === "cells" ? nextCell([dx, dy]) : nextPoint(dx, dy);

/** The record in the next cell that has one; the chosen one at the edge of the map. */
function nextCell(step) {
  const at = [data.at[0][chosen], data.at[1][chosen]], lengths = data.edges.map(edges => edges.length - 1);
  for (let tries = 0; tries < Math.max(...lengths); tries++) {
    for (const k of [0, 1]) {
      at[k] += step[k];
      if (data.closed[k]) at[k] = mod(at[k], lengths[k]);
      if (at[k] < 0 || at[k] >= lengths[k]) return chosen;
    }
    const record = recordAt.get(`${shownKey()}|${at}`);
    if (record !== undefined) return record;
  }
  return chosen;
}

/** The next record of the chosen one's row along x, else the record at the same place in the next row. */
function nextPoint(dx, dy) {
  const clamped = (list, k) => list[Math.min(Math.max(k, 0), list.length - 1)];
  const records = rowOf(chosen), place = records.indexOf(chosen);
  if (dx && records.length > 1) return clamped(records, place + dx);
  const rows = [...recordsOf.values()].filter(([first]) => sliceKey(first) === sliceKey(chosen));
  return clamped(clamped(rows, rows.indexOf(records) + (dy || dx)), place);
}
