// The body on a canvas, from the side.

// The side view's own drawing: gaitsweep/view/movie/side_view.py.
const ASIDE = [0.28, 0.22];

const SWING = "#D55E00";                        // of limbs off the ground, where limbs have no colours of their own

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
  return { points: points[k].map((each, c) => mix(each, points[next][c])), camera: mix(camera[k], camera[next]) + advance };
}

/** How far the camera goes in a stretch, m. */
function wayOf(each) {
  const { camera } = picturesOf(each);
  return camera[camera.length - 1] - camera[0];
}

/** Whether a limb is on the ground at a time (s) of a stretch. */
function isOnGround(motion, limb, at) {
  const sample = Math.min(Math.round(at / motion.sample), motion.samples - 1), turns = motion.contact[limb];
  let passed = 0;
  while (passed < turns.length && turns[passed] <= sample) passed++;
  return passed % 2 === 1;
}

function hull(points) {
  const sorted = [...points].sort((p, q) => p[0] - q[0] || p[1] - q[1]);
  const turn = (o, p, q) => (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
  const half = list => list.reduce((kept, p) => {
    while (kept.length > 1 && turn(kept[kept.length - 2], kept[kept.length - 1], p) <= 0) kept.pop();
    kept.push(p);
    return kept;
  }, []);
  return [...half(sorted).slice(0, -1), ...half(sorted.reverse()).slice(0, -1)];
}

function roundStep(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return power * [1, 2, 5, 10].find(head => head * power >= length * (1 - 1e-9));
}

/** The points with feet `lift` times as high over their lowest place in the stretch, and joints in proportion. */
function withLiftedFeet(motion, points) {
  const factor = Number($("lift").value) - 1, raised = [...points];
  let from = 0;
  for (const n of data.figure.limbs) {
    const foot = from + 2 * n - 1, lowest = motion.lowest ??= {};
    lowest[foot] ??= Math.min(...picturesOf(motion).points.map(each => each[foot]));
    for (let j = 1; j < n; j++) raised[from + 2 * j + 1] += factor * (points[foot] - lowest[foot]) * j / (n - 1);
    from += 2 * n;
  }
  return raised;
}

function paintBody(canvas, motion, at, turns) {
  const { pen, width, height } = surface(canvas), look = data.figure;
  const { points: seenPoints, camera } = bodyAt(motion, at, turns), points = withLiftedFeet(motion, seenPoints);
  const nearEdge = -ASIDE[1] * look.depth, low = nearEdge - 0.24 * look.height, high = 1.2 * look.height;
  const scale = Math.min(height / (high - low), width / (2.3 * look.half));
  const base = height - (height - scale * (high - low)) / 2 + scale * low;
  const place = (x, y) => [width / 2 + x * scale, base - y * scale];
  const thick = Math.max(0.5, Math.min(1.5, look.height * scale / 110));
  const path = list => { pen.beginPath(); list.forEach(([x, y], k) => k ? pen.lineTo(x, y) : pen.moveTo(x, y)); };

  // the ground, its marks, and how far the body has come
  const [, top] = place(0, -nearEdge), [, bottom] = place(0, nearEdge), reach = width / 2 / scale + ASIDE[0] * look.depth;
  pen.fillStyle = shade.strip;
  pen.fillRect(0, top, width, bottom - top);
  const walks = Math.abs(wayOf(motion)) > 1e-3 * look.half;
  const step = roundStep(width / scale / 7), digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  pen.font = "11px system-ui, DejaVu Sans, sans-serif";
  pen.strokeStyle = shade.tick;
  pen.fillStyle = shade.length;
  pen.lineWidth = 1;
  for (let m = Math.ceil((camera - reach) / step); walks && m * step <= camera + reach; m++) {
    const ahead = m * step - camera, near = place(ahead - ASIDE[0] * look.depth, nearEdge);
    path([near, place(ahead + ASIDE[0] * look.depth, -nearEdge)]);
    pen.stroke();
    pen.fillText(`${(m * step + 0).toFixed(digits)} m`.replace("-0 ", "0 "), near[0] + 3, near[1] - 3);
  }

  // points are in the order limbs, bodies, springs
  let from = 0;
  const take = k => { const list = []; for (let j = 0; j < k; j++) list.push(place(points[from + 2 * j], points[from + 2 * j + 1])); from += 2 * k; return list; };
  const limbs = look.limbs.map(take), bodies = look.bodies.map(take);
  const springs = Array.from({ length: look.springs }, () => take(2));
  const sole = 0.05 * look.height * scale, stands = limbs.map((_, k) => isOnGround(motion, k, at));
  pen.lineCap = pen.lineJoin = "round";
  limbs.forEach((limb, k) => {
    if (!stands[k]) return;
    const [x, y] = limb[limb.length - 1];
    pen.strokeStyle = shade.bone;
    pen.lineWidth = 2.4 * thick;
    path([[x - sole, y], [x + sole, y]]);
    pen.stroke();
  });
  const drawLimb = k => {
    const limb = limbs[k], colour = limbsAreAlike() && !stands[k] ? visible(SWING) : limbColour(data.limbs[k]);
    pen.strokeStyle = colour;
    pen.lineWidth = 4 * thick;
    path(limb);
    pen.stroke();
    limb.forEach(([x, y], j) => {
      const foot = j === limb.length - 1;
      pen.beginPath();
      pen.arc(x, y, (foot ? 3.8 : 2.9) * thick, 0, TURN);
      pen.fillStyle = foot && stands[k] ? colour : shade.paper;
      pen.lineWidth = 1.6 * thick;
      pen.fill();
      pen.stroke();
    });
  };
  limbs.forEach((_, k) => { if (data.limbs[k].far) drawLimb(k); });
  pen.strokeStyle = shade.bone;
  for (const body of bodies) {
    for (const [part, face] of [[body, shade.body], [body.slice(0, (body.length + 1) >> 1), shade.near]]) {
      path(part.length > 2 ? hull(part) : part);
      pen.closePath();
      pen.fillStyle = face;
      pen.lineWidth = 0.9 * thick;
      pen.fill();
      pen.stroke();
    }
  }
  for (const [a, b] of springs) {
    const along = [b[0] - a[0], b[1] - a[1]], size = Math.hypot(...along) || 1, normal = [-along[1] / size, along[0] / size];
    const zigzag = Array.from({ length: 12 }, (_, k) => {
      const share = k === 0 ? 0 : k === 11 ? 1 : 0.2 + 0.6 * (k - 1) / 10, aside = k > 1 && k < 11 ? 0.6 * sole * (k % 2 ? 1 : -1) : 0;
      return [a[0] + share * along[0] + aside * normal[0], a[1] + share * along[1] + aside * normal[1]];
    });
    pen.lineWidth = 1.1 * thick;
    path(zigzag);
    pen.stroke();
  }
  limbs.forEach((_, k) => { if (!data.limbs[k].far) drawLimb(k); });
  pen.fillStyle = shade.faint;
  pen.textAlign = "right";
  pen.fillText("forward ⟶", width - 6, 14);
  pen.textAlign = "left";
}
