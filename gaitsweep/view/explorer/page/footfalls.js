// The footfall diagram: the times at which feet are on the ground.

/** Draw the footfalls of the stretch on view, with a line at a time (s) of it. */
function paintFootfalls(at) {
  const canvas = $("footfalls"), n = data.limbs.length, row = n > 12 ? 9 : 17;
  canvas.style.height = `${n * row + 24}px`;
  const { pen, width } = surface(canvas), length = lengthOf(motion);
  pen.font = "12px system-ui, DejaVu Sans, sans-serif";
  const left = Math.max(...data.limbs.map(limb => pen.measureText(limb.name).width)) + 12, right = width - 8;
  const x = t => left + (right - left) * t / length;
  paintBars(pen, x, row, left, right);
  if (limbsAreAlike()) paintWave(pen, x, row);
  const below = n * row + 2;
  paintTimes(pen, x, below, right);
  pen.strokeStyle = shade.mark;
  pen.lineWidth = 1.4;
  tracePath(pen, [[x(at), 0], [x(at), below]]);
  pen.stroke();
}

/** Draw the bars of all limbs, `row` pixels a limb, with some of their names. */
function paintBars(pen, x, row, left, right) {
  const length = lengthOf(motion), every = Math.ceil(data.limbs.length / 16);
  data.limbs.forEach((limb, k) => {
    const y = k * row + 2;
    if (k % every === 0) {
      pen.fillStyle = shade.ink;
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      pen.fillText(limb.name, left - 8, y + row / 2 - 1);
    }
    pen.fillStyle = shade.bar;
    pen.fillRect(left, y, right - left, row - 4);
    pen.fillStyle = limbColour(limb);
    const turns = motion.contact[k];
    for (let j = 0; j + 1 < turns.length; j += 2) {
      const begin = x(Math.max(0, (turns[j] - 0.5) * motion.sample)), end = x(Math.min(length, (turns[j + 1] - 0.5) * motion.sample));
      pen.fillRect(begin, y, end - begin, row - 4);
    }
  });
}

/** Draw the axis of time (s) at a height. */
function paintTimes(pen, x, below, right) {
  pen.strokeStyle = pen.fillStyle = shade.faint;
  pen.textAlign = "center";
  pen.textBaseline = "top";
  const length = lengthOf(motion), step = roundStep(length / 5);
  for (let m = Math.ceil(motion.begin / step); m * step <= motion.begin + length + 1e-9; m++) {
    const place = x(m * step - motion.begin);
    tracePath(pen, [[place, below - 2], [place, below + 2]]);
    pen.stroke();
    if (place < right - 20) pen.fillText((m * step).toFixed(digitsOf(step)), place, below + 5);
  }
  pen.textAlign = "right";
  pen.fillText("s", right, below + 5);
}

/** Draw the wave of swings: lines from the instants at which a leg lifts to the nearest ones of the next leg. */
function paintWave(pen, x, row) {
  const lifts = motion.contact.map(turns => turns.filter((sample, j) => j % 2 && sample < motion.samples));
  const halfCycle = data.cycle / 2 / motion.sample;
  pen.strokeStyle = visible(SWING);
  pen.lineWidth = 1.6;
  pen.beginPath();
  lifts.slice(1).forEach((next, k) => lifts[k].forEach(at => {
    const nearest = next.reduce((best, lift) => Math.abs(lift - at) < Math.abs(best - at) ? lift : best, Infinity);
    if (Math.abs(nearest - at) >= halfCycle) return;
    pen.moveTo(x(at * motion.sample), (k + 0.5) * row);
    pen.lineTo(x(nearest * motion.sample), (k + 1.5) * row);
  }));
  pen.stroke();
}
