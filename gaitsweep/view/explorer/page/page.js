"use strict";
// The explorer: the map of a table's records by plotly.js, and the body of the chosen one on a canvas.
//
// The files of this folder are joined to one script, in the order in which explorer.html names them: this one is
// its first, and `begin.js` its last. `records.js` has the state that all of them share.

const TURN = 2 * Math.PI;

const $ = id => document.getElementById(id);
const mod = (a, n) => ((a % n) + n) % n;
