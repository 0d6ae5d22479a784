// The choice of values for the axes that are not drawn, and the legend of the outcomes.

const MOST_BUTTONS = 5;                         // values of an axis; more are in a list

/** The record at the chosen one's cell in another slice, else the first record of that slice; -1 without one. */
function recordInSlice(key) {
  const sameCell = data.kind === "cells" ? recordAt.get(`${key}|${cellKey(chosen)}`) : undefined;
  if (sameCell !== undefined) return sameCell;
  for (let i = 0; i < count; i++) if (sliceKey(i) === key) return i;
  return -1;
}

/** Show the slice with a value of axis k. */
function pickSlice(k, value) {
  const picked = slice.map((shown, j) => j === k ? value : shown), record = recordInSlice(picked.join(","));
  if (record < 0) {  // of a table that is not complete
    showSlices();
    $("live").textContent = $("elsewhere").textContent = `No row with ${plain(data.slices[k].texts[value])} has ended yet.`;
  } else choose(record);
  const box = $("slices").children[k];
  (box.querySelector("select") || box.children[value]).focus();
}

function sliceList(axis, k) {
  const label = document.createElement("label"), select = document.createElement("select");
  axis.texts.forEach((text, value) => select.add(new Option(plain(text), value, false, slice[k] === value)));
  select.onchange = () => pickSlice(k, Number(select.value));
  label.append(plain(axis.name), select);
  return label;
}

function sliceButtons(axis, k) {
  const box = document.createElement("fieldset");
  axis.texts.forEach((text, value) => {
    const button = document.createElement("button");
    button.type = "button";
    button.innerHTML = text;
    button.setAttribute("aria-pressed", slice[k] === value);
    button.onclick = () => pickSlice(k, value);
    box.append(button);
  });
  return box;
}

function showSlices() {
  const boxes = data.slices.map((axis, k) => axis.texts.length > MOST_BUTTONS ? sliceList(axis, k) : sliceButtons(axis, k));
  $("slices").replaceChildren(...boxes);
}

function showLegend() {
  const counts = data.outcomes.map(() => 0), key = shownKey();
  let total = 0;
  for (let i = 0; i < count; i++) if (sliceKey(i) === key) { counts[data.outcome[i]]++; total++; }
  $("legend").replaceChildren(...data.outcomes.map((outcome, k) => {
    const item = document.createElement("li"), share = 100 * counts[k] / total;
    item.append(chip(outcome), `${outcome.name} ${share > 0 && share < 0.5 ? "<1" : share.toFixed(0)} %`);
    return item;
  }));
  for (const rises of data.passes.length ? [true, false] : []) {
    const item = document.createElement("li"), pass = data.passes.find(one => one.rises === rises), sign = document.createElement("span");
    sign.textContent = rises ? "▲" : "▼";
    item.append(sign, ` ${passText(pass)}, line ${rises ? "solid" : "dashed"}`);
    $("legend").append(item);
  }
  if (columns.stable) {
    const item = document.createElement("li");
    item.textContent = "branch solid where stable, dashed where unstable";
    $("legend").append(item);
  }
}
