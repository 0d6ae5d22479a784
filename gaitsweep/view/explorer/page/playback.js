// Playback of a stretch: the clock, its speed, and the drawing at each instant.

const CYCLE_SECONDS = 1.6;                      // that a cycle takes at the speed shown first

const clock = { at: 0, turns: 0, playing: false, speed: 1, last: 0 };

/** The duration of a stretch, s. */
const lengthOf = motion => (motion.samples - 1) * motion.sample;

function tick(now) {
  if (clock.playing && motion) {
    const length = lengthOf(motion), pause = motion.loops ? 0 : 0.6 * clock.speed;
    clock.at += Math.min(now - clock.last, 100) / 1000 * clock.speed;
    while (clock.at > length + pause) { clock.at -= length + pause; clock.turns += 1; }
    paint();
  }
  clock.last = now;
  requestAnimationFrame(tick);
}

function play(on) {
  clock.playing = on;
  $("play").textContent = on ? "❚❚" : "▶";
  $("play").setAttribute("aria-label", on ? "pause" : "play");
}

function paint() {
  if (!motion) { $("clock").textContent = ""; return; }
  const length = lengthOf(motion), at = Math.min(clock.at, length);
  $("time").value = length ? Math.round(at / length * 1000) : 0;
  $("clock").textContent = `${(motion.begin + at).toFixed(2)} s`;
  if (motion.points !== undefined) paintBody($("body"), motion, at, clock.turns);
  if (beside) paintBeside($("beside-body"), beside, at, clock.turns * length + at);
  if (motion.contact.length) paintFootfalls(at);
}

/** Draw the body beside the chosen one, at a time (s) of the chosen one's stretch and after all its turns. */
function paintBeside(canvas, beside, at, elapsed) {
  const length = lengthOf(beside);
  if (beside.loops) paintBody(canvas, beside, elapsed % length, Math.floor(elapsed / length));
  else paintBody(canvas, beside, Math.min(at, length), 0);
}

/** A speed relative to real time, in words. */
function speedText(speed) {
  if (speed === 1) return "real time";
  return speed < 1 ? `${1 / speed} times slower` : `${speed} times faster`;
}

function fillSpeeds() {
  const usual = data.cycle / CYCLE_SECONDS, speeds = [0.02, 0.05, 0.1, 0.2, 0.4, 1, 2, 5];
  const ratio = speed => Math.abs(Math.log(speed / usual));
  clock.speed = speeds.reduce((best, speed) => ratio(speed) < ratio(best) ? speed : best);
  for (const speed of speeds) $("speed").add(new Option(speedText(speed), speed, false, speed === clock.speed));
  $("speed").onchange = () => clock.speed = Number($("speed").value);
}

/** The choice of how high feet are lifted in the drawing. */
function fillLifts() {
  for (const times of [1, 2, 3, 5]) $("lift").add(new Option(times === 1 ? "lift as it is" : `lift ${times} times as high`, times));
  $("lift").onchange = paint;
  $("lift").hidden = !data.figure || !data.figure.limbs.length;
}
