// The choice of values for the axes that are not drawn, and the legend of the outcomes.

function showSlices() {
  $("slices").replaceChildren(...data.slices.map((each, k) => {
    const several = each.texts.length > 5, label = document.createElement(several ? "label" : "fieldset");
    const pick = value => {
      const before = slice;
      slice = slice.map((old, j) => j === k ? value : old);
      const key = shownKey(), at = data.kind === "cells" ? cellKey(chosen) : null;
      let next = at !== null && recordAt.has(`${key}|${at}`) ? recordAt.get(`${key}|${at}`) : -1;
      for (let i = 0; i < count && next < 0; i++) if (sliceKey(i) === key) next = i;
      if (next < 0) {  // of a table that is not complete
        slice = before;
        showSlices();
        $("live").textContent = $("elsewhere").textContent = `No row with ${plain(each.texts[value])} has ended yet.`;
      } else {
        slice = [];
        choose(next);
      }
      const again = $("slices").children[k];
      (again.querySelector("select") || again.children[value]).focus();
    };
    if (several) {
      const select = document.createElement("select");
      each.texts.forEach((text, value) => select.add(new Option(plain(text), value, false, slice[k] === value)));
      select.onchange = () => pick(Number(select.value));
      label.append(plain(each.name), select);
    } else each.texts.forEach((text, value) => {
      const button = document.createElement("button");
      button.type = "button";
      button.innerHTML = text;
      button.setAttribute("aria-pressed", slice[k] === value);
      button.onclick = () => pick(value);
      label.append(button);
    });
    return label;
  }));
}

function showLegend() {
  const shares = data.outcomes.map(() => 0), key = shownKey();
  let all = 0;
  for (let i = 0; i < count; i++) if (sliceKey(i) === key) { shares[data.outcome[i]]++; all++; }
  $("legend").replaceChildren(...data.outcomes.map((outcome, k) => {
    const item = document.createElement("li"), share = 100 * shares[k] / all;
    item.append(chip(outcome), `${outcome.name} ${share > 0 && share < 0.5 ? "<1" : share.toFixed(0)} %`);
    return item;
  }));
  for (const rises of data.passes.length ? [true, false] : []) {
    const item = document.createElement("li"), pass = data.passes.find(each => each.rises === rises), sign = document.createElement("span");
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
