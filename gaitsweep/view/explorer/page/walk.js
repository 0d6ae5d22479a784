// The simulated walk of the chosen record: its stretches, beside another one if that is asked for.

let walkOf = new Map();                           // walks by record
let walk = null, motion = null;                   // what is shown, and the stretch of it

/** The walk of a record: its own, or that of the row (of kinds whose rows walk as a whole). */
function walkFor(i) {
  if (walkOf.has(i)) return [walkOf.get(i), i];
  for (const j of recordsOf.get(raw(columns.row, i)))
    if (data.run === "return_map" && walkOf.has(j)) return [walkOf.get(j), i];
  const near = nearest(i, j => walkOf.has(j) && data.outcome[j] === data.outcome[i]);
  return near < 0 ? [null, -1] : [walkOf.get(near), near];
}

/** Show the walk of the chosen record, in the stretch of the same name as before, else in its last. */
function showWalk() {
  const [shown, owner] = walkFor(chosen), before = motion ? motion.name : null;
  walk = shown;
  const note = $("instead"), texts = [];
  if (!walk && !columns.multiplier) texts.push("The page has no animation of this outcome here.");
  else if (walk && owner !== chosen) texts.push(`The animation shows ${nameOf(owner)}, the nearest record with this outcome that has one; records with an animation have a dot on the map.`);
  if (walk && walk.later) texts.push(`When it was simulated again with intermediate samples, this start ended with the gait ${walk.later}: it is on a boundary, or drifts.`);
  if (walk && walk.apart) texts.push(`When it was simulated again with intermediate samples, its phases differed by ${walk.apart.toPrecision(2)} rad from those of the record.`);
  if (walk && walk.share) texts.push(`When it was simulated again with intermediate samples, an observable differed from that of the record by ${(100 * walk.share).toPrecision(2)} % of its size.`);
  note.hidden = !texts.length;
  note.textContent = texts.join(" ");
  const group = $("stretches");
  group.replaceChildren();
  const motions = walk ? walk.motions : [];
  motions.forEach(({ name }, k) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = name;
    button.onclick = () => showMotion(k);
    group.append(button);
  });
  const same = motions.findIndex(({ name }) => name === before);
  showMotion(same >= 0 ? same : Math.max(0, motions.length - 1));
  showPhases();
}

let beside = null;                                // the motion of the nearest start with another outcome, if shown

/** Show the nearest start with another outcome in step with the chosen one, if that is asked for. */
function showBeside() {
  const [otherWalk, owner] = other < 0 ? [null, -1] : walkFor(other), both = motion && motion.points !== undefined && otherWalk;
  const drawn = both ? otherWalk.motions.filter(({ points }) => points !== undefined) : [];
  $("compare").hidden = !drawn.length;
  const on = drawn.length && $("compare").getAttribute("aria-pressed") === "true";
  beside = on ? drawn.find(({ name }) => name === motion.name) || drawn.at(-1) : null;
  $("beside").hidden = !beside;
  $("body-name").replaceChildren(...(beside ? [chip(outcomeOf(chosen)), `${outcomeOf(chosen).name}, ${nameOf(walkFor(chosen)[1])}`] : []));
  $("beside-name").replaceChildren(...(beside ? [chip(outcomeOf(other)), `${outcomeOf(other).name}, ${nameOf(owner)}`] : []));
  $("beside-body").setAttribute("aria-label", beside ? `stick figure of ${nameOf(owner)}, ${beside.name}` : "");
}

function showMotion(k) {
  motion = walk && walk.motions.length ? walk.motions[k] : null;
  [...$("stretches").children].forEach((button, j) => button.setAttribute("aria-pressed", j === k));
  clock.at = 0;
  clock.turns = 0;
  const drawn = motion && motion.points !== undefined;
  $("stretches").hidden = !motion;
  $("bodies").hidden = $("save-gif").hidden = !drawn;
  showBeside();
  $("controls").hidden = !motion || (!drawn && !motion.contact.length);
  $("footfalls").hidden = $("footfalls-title").hidden = !motion || !motion.contact.length;
  $("body").setAttribute("aria-label", drawn ? `stick figure of ${nameOf(chosen)}, ${motion.name}` : "");
  $("footfalls").setAttribute("aria-label", "footfall diagram: when each foot is on the ground");
  for (const element of document.querySelectorAll("#bodies, #footfalls, #footfalls-title, #controls, #stretches"))
    element.style.display = element.hidden ? "none" : "";
  paint();
}
