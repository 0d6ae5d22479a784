// When each foot is on the ground.

function paintFootfalls(at) {
  const canvas = $("footfalls"), n = data.limbs.length, row = n > 12 ? 9 : 17;
  canvas.style.height = `${n * row + 24}px`;
  const { pen, width } = surface(canvas), length = lengthOf(motion), every = Math.ceil(n / 16);
  pen.font = "12px system-ui, DejaVu Sans, sans-serif";
  const left = Math.max(...data.limbs.map(limb => pen.measureText(limb.name).width)) + 12, right = width - 8;
  const x = t => left + (right - left) * t / length;
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
  if (limbsAreAlike()) paintWave(pen, x, row);
  const below = n * row + 2;
  pen.strokeStyle = pen.fillStyle = shade.faint;
  pen.textAlign = "center";
  pen.textBaseline = "top";
  const step = roundStep(length / 5), digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  for (let m = Math.ceil(motion.begin / step); m * step <= motion.begin + length + 1e-9; m++) {
    const place = x(m * step - motion.begin);
    pen.beginPath();
    pen.moveTo(place, below - 2);
    pen.lineTo(place, below + 2);
    pen.stroke();
    if (place < right - 20) pen.fillText(`${(m * step).toFixed(digits)}`, place, below + 5);
  }
  pen.textAlign = "right";
  pen.fillText("s", right, below + 5);
  pen.strokeStyle = shade.mark;
  pen.lineWidth = 1.4;
  pen.beginPath();
  pen.moveTo(x(at), 0);
  pen.lineTo(x(at), below);
  pen.stroke();
}

/** The wave of swings: lines from the instants at which a leg lifts to the nearest ones of the next leg. */
function paintWave(pen, x, row) {
  const lifts = motion.contact.map(turns => turns.filter((at, j) => j % 2 && at < motion.samples)), half = data.cycle / 2 / motion.sample;
  pen.strokeStyle = visible(SWING);
  pen.lineWidth = 1.6;
  pen.beginPath();
  lifts.slice(1).forEach((next, k) => lifts[k].forEach(at => {
    const nearest = next.reduce((best, each) => Math.abs(each - at) < Math.abs(best - at) ? each : best, Infinity);
    if (Math.abs(nearest - at) >= half) return;
    pen.moveTo(x(at * motion.sample), (k + 0.5) * row);
    pen.lineTo(x(nearest * motion.sample), (k + 1.5) * row);
  }));
  pen.stroke();
}
