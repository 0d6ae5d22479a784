// The body on a canvas, from the side.

// The side view's own drawing: gaitsweep/view/movie/side_view.py.
const ASIDE = [0.28, 0.22];

const SWING = "#D55E00";                        // of limbs off the ground, where limbs have no colours of their own
const SPRING_CORNERS = 12;

/** The context of a canvas, cleared, and its size; that of a canvas outside the page is its own. */
function surface(canvas) {
  if (!canvas.isConnected) {
    const pen = canvas.getContext("2d"), { width, height } = canvas;
    pen.clearRect(0, 0, width, height);
    return { pen, width, height };
  }
  const scale = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

const limbsAreAlike = () => data.limbs.length > 1 && data.limbs.every(limb => limb.colour === "#000000");

/** The points and the camera at a time (s) of a stretch after some turns of it, linear between pictures. */
function bodyAt(motion, at, turns) {
  const { points, camera } = picturesOf(motion), step = motion.sample * motion.stride;
  const k = Math.min(Math.floor(at / step), points.length - 1), next = Math.min(k + 1, points.length - 1);
  const share = Math.min(at / step - k, 1), mix = (a, b) => a + share * (b - a);
  const advance = motion.loops ? turns * (camera[camera.length - 1] - camera[0]) : 0;
  return { points: points[k].map((coordinate, c) => mix(coordinate, points[next][c])), camera: mix(camera[k], camera[next]) + advance };
}

/** The distance that the camera travels in a stretch, m. */
function distanceOf(motion) {
  const { camera } = picturesOf(motion);
  return camera[camera.length - 1] - camera[0];
}

/** Whether a limb is on the ground at a time (s) of a stretch. */
function isOnGround(motion, limb, at) {
  const sample = Math.min(Math.round(at / motion.sample), motion.samples - 1), turns = motion.contact[limb];
  let passed = 0;
  while (passed < turns.length && turns[passed] <= sample) passed++;
  return passed % 2 === 1;
}

/** The corners of the convex hull of points (Andrew's monotone chain). */
function hull(points) {
  const sorted = [...points].sort((p, q) => p[0] - q[0] || p[1] - q[1]);
  const turn = (o, p, q) => (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
  const halfHull = ordered => ordered.reduce((corners, p) => {
    while (corners.length > 1 && turn(corners.at(-2), corners.at(-1), p) <= 0) corners.pop();
    corners.push(p);
    return corners;
  }, []);
  return [...halfHull(sorted).slice(0, -1), ...halfHull(sorted.reverse()).slice(0, -1)];
}

/** The next number from 1, 2, 5, 10 times a power of ten. */
function roundStep(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [1, 2, 5, 10].find(digit => digit * power >= length * (1 - 1e-9));
}

/** The decimal places of multiples of a step. */
const digitsOf = step => Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));

/** The points with feet `lift` times as high over their lowest place in the stretch, and joints in proportion. */
function withLiftedFeet(motion, points) {
  const factor = Number($("lift").value) - 1, raised = [...points];
  let first = 0;
  for (const n of data.figure.limbs) {
    const foot = first + 2 * n - 1, lowest = motion.lowest ??= {};
    lowest[foot] ??= Math.min(...picturesOf(motion).points.map(picture => picture[foot]));
    for (let j = 1; j < n; j++) raised[first + 2 * j + 1] += factor * (points[foot] - lowest[foot]) * j / (n - 1);
    first += 2 * n;
  }
  return raised;
}

/** The places (pixels) of points that are in the order limbs, bodies, springs. */
function partsOf(points, place) {
  let first = 0;
  const next = n => {
    const part = Array.from({ length: n }, (_, j) => place(points[first + 2 * j], points[first + 2 * j + 1]));
    first += 2 * n;
    return part;
  };
  const { limbs, bodies, springs } = data.figure;
  return { limbs: limbs.map(next), bodies: bodies.map(next), springs: Array.from({ length: springs }, () => next(2)) };
}

function tracePath(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], k) => k ? pen.lineTo(x, y) : pen.moveTo(x, y));
}

/** The scale of a canvas: `place` of a point (m), pixels a metre, and the near edge of the ground (m). */
function scaleOf({ width, height }) {
  const { depth, half, height: tall } = data.figure;
  const nearEdge = -ASIDE[1] * depth, low = nearEdge - 0.24 * tall, high = 1.2 * tall;
  const perMetre = Math.min(height / (high - low), width / (2.3 * half));
  const base = height - (height - perMetre * (high - low)) / 2 + perMetre * low;
  return { place: (x, y) => [width / 2 + x * perMetre, base - y * perMetre], perMetre, nearEdge };
}

/** Draw the ground, with marks that show the distance that the body has travelled. */
function paintGround(pen, { width }, { place, perMetre, nearEdge }, motion, camera) {
  const { depth, half } = data.figure;
  const [, top] = place(0, -nearEdge), [, bottom] = place(0, nearEdge);
  pen.fillStyle = shade.strip;
  pen.fillRect(0, top, width, bottom - top);
  if (Math.abs(distanceOf(motion)) <= 1e-3 * half) return;
  const reach = width / 2 / perMetre + ASIDE[0] * depth, step = roundStep(width / perMetre / 7);
  pen.strokeStyle = shade.tick;
  pen.fillStyle = shade.length;
  pen.lineWidth = 1;
  for (let m = Math.ceil((camera - reach) / step); m * step <= camera + reach; m++) {
    const ahead = m * step - camera, near = place(ahead - ASIDE[0] * depth, nearEdge);
    tracePath(pen, [near, place(ahead + ASIDE[0] * depth, -nearEdge)]);
    pen.stroke();
    pen.fillText(`${(m * step + 0).toFixed(digitsOf(step))} m`.replace("-0 ", "0 "), near[0] + 3, near[1] - 3);
  }
}

/** Draw the links of limb k with its joints, and its foot, filled on the ground. */
function paintLimb(pen, limb, k, stands, thickness) {
  const colour = limbsAreAlike() && !stands ? visible(SWING) : limbColour(data.limbs[k]);
  pen.strokeStyle = colour;
  pen.lineWidth = 4 * thickness;
  tracePath(pen, limb);
  pen.stroke();
  limb.forEach(([x, y], j) => {
    const isFoot = j === limb.length - 1;
    pen.beginPath();
    pen.arc(x, y, (isFoot ? 3.8 : 2.9) * thickness, 0, TURN);
    pen.fillStyle = isFoot && stands ? colour : shade.paper;
    pen.lineWidth = 1.6 * thickness;
    pen.fill();
    pen.stroke();
  });
}

/** Draw a mark of half the width `sole` (pixels) below a foot on the ground. */
function paintSole(pen, [x, y], sole, thickness) {
  pen.strokeStyle = shade.bone;
  pen.lineWidth = 2.4 * thickness;
  tracePath(pen, [[x - sole, y], [x + sole, y]]);
  pen.stroke();
}

/** Draw the outline of a body, and its near side: the first half of its points. */
function paintPart(pen, points, thickness) {
  for (const [part, face] of [[points, shade.body], [points.slice(0, (points.length + 1) >> 1), shade.near]]) {
    tracePath(pen, part.length > 2 ? hull(part) : part);
    pen.closePath();
    pen.fillStyle = face;
    pen.lineWidth = 0.9 * thickness;
    pen.fill();
    pen.stroke();
  }
}

/** Draw a spring between two points, straight at both ends, that is 1.2 `sole` (pixels) wide. */
function paintSpring(pen, [begin, end], sole, thickness) {
  const along = [end[0] - begin[0], end[1] - begin[1]], length = Math.hypot(...along) || 1;
  const across = [-along[1] / length, along[0] / length], last = SPRING_CORNERS - 1;
  const corners = Array.from({ length: SPRING_CORNERS }, (_, k) => {
    if (k === 0) return begin;
    if (k === last) return end;
    const share = 0.2 + 0.6 * (k - 1) / (last - 1), aside = k > 1 ? 0.6 * sole * (k % 2 ? 1 : -1) : 0;
    return [0, 1].map(axis => begin[axis] + share * along[axis] + aside * across[axis]);
  });
  pen.lineWidth = 1.1 * thickness;
  tracePath(pen, corners);
  pen.stroke();
}

/** Draw the body at a time (s) of a stretch after some turns of it. */
function paintBody(canvas, motion, at, turns) {
  const { pen, ...size } = surface(canvas), scale = scaleOf(size);
  const { points, camera } = bodyAt(motion, at, turns);
  pen.font = "11px system-ui, DejaVu Sans, sans-serif";
  paintGround(pen, size, scale, motion, camera);
  const { limbs, bodies, springs } = partsOf(withLiftedFeet(motion, points), scale.place);
  const tall = data.figure.height * scale.perMetre, sole = 0.05 * tall;
  const thickness = Math.max(0.5, Math.min(1.5, tall / 110));
  const stands = limbs.map((_, k) => isOnGround(motion, k, at));
  const paintLimbs = far => limbs.forEach((limb, k) => { if (data.limbs[k].far === far) paintLimb(pen, limb, k, stands[k], thickness); });
  pen.lineCap = pen.lineJoin = "round";
  limbs.forEach((limb, k) => { if (stands[k]) paintSole(pen, limb.at(-1), sole, thickness); });
  paintLimbs(true);
  pen.strokeStyle = shade.bone;
  for (const body of bodies) paintPart(pen, body, thickness);
  for (const spring of springs) paintSpring(pen, spring, sole, thickness);
  paintLimbs(false);
  pen.fillStyle = shade.faint;
  pen.textAlign = "right";
  pen.fillText("forward ⟶", size.width - 6, 14);
  pen.textAlign = "left";
}
