// Unpacking of texts, numbers, pictures and observables that `encoding.py` packs.

const LARGEST = 32767, NO_NUMBER = -32768;      // of whole numbers of two bytes, as encoding.py packs them

function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);  // browsers of 2025
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

async function unpacked(id) {
  const stream = new Blob([bytesOf($(id).textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  const text = await new Response(stream).text();
  $(id).remove();
  return text;
}

function numbersOf(text) {
  const bytes = bytesOf(text), n = bytes.length / 2, numbers = new Int16Array(n);
  for (let i = 0; i < n; i++) numbers[i] = bytes[i] | (bytes[n + i] << 8);
  return numbers;
}

/** Pictures of a stretch: points (m) by picture, and the camera's place (m). */
function picturesOf(motion) {
  if (motion.points === undefined) return null;
  if (motion.unpacked) return motion.unpacked;
  const steps = numbersOf(motion.points), n = motion.pictures, columns = steps.length / n;
  const points = Array.from({ length: n }, () => new Float64Array(columns));
  for (let c = 0; c < columns; c++) {
    let at = 0;
    for (let k = 0; k < n; k++) points[k][c] = (at += steps[c * n + k]) * motion.unit;
  }
  return motion.unpacked = { points, camera: points.map(picture => motion.ground + picture[columns - 1]) };
}

/** The observables over the cycles: an array of numbers (null where there is none) for each series. */
function seriesOf(walk) {
  const integers = numbersOf(walk.crossings.values), n = data.series.length ? integers.length / data.series.length : 0;
  return data.series.map(({ low, high }, s) => Array.from({ length: n }, (_, k) => {
    const integer = integers[s * n + k];
    return integer === NO_NUMBER ? null : low + (integer + LARGEST) / (2 * LARGEST) * (high - low);
  }));
}
