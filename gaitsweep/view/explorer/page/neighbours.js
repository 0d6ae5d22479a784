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
