// Animated GIFs (version 89a, CompuServe 1990) of pictures of a canvas, with one palette for all pictures.

const UNCHANGED = 255;                          // entry of the palette for pixels as in the picture before
const MOST_CODES = 4096, CLEAR = 256, END = 257;
const SAMPLED = 8;                              // pictures from which the palette is made

/** A palette with the most frequent colours (0xBBGGRR) of some pictures, and the entry nearest to a colour. */
function paletteOf(pictures) {
  const counts = new Map(), channels = colour => [colour & 255, colour >> 8 & 255, colour >> 16 & 255];
  for (const picture of pictures) for (const pixel of picture) counts.set(pixel & 0xffffff, (counts.get(pixel & 0xffffff) || 0) + 1);
  const colours = [...counts].sort((a, b) => b[1] - a[1]).slice(0, UNCHANGED).map(([colour]) => channels(colour));
  const entries = new Map();
  const entryOf = colour => {
    if (entries.has(colour)) return entries.get(colour);
    const [red, green, blue] = channels(colour);
    let entry = 0, least = Infinity;
    colours.forEach(([r, g, b], k) => {
      const difference = (r - red) ** 2 + (g - green) ** 2 + (b - blue) ** 2;
      if (difference < least) { least = difference; entry = k; }
    });
    entries.set(colour, entry);
    return entry;
  };
  return { colours, entryOf };
}

/** Entries of a palette compressed by Lempel, Ziv and Welch, in blocks of at most 255 bytes. */
function blocksOf(entries) {
  const bytes = [], codes = new Map();
  let width = 9, next = END + 1, buffer = 0, bits = 0, prefix = entries[0];
  const put = code => {
    buffer |= code << bits;
    for (bits += width; bits >= 8; bits -= 8, buffer >>>= 8) bytes.push(buffer & 255);
  };
  put(CLEAR);
  for (let i = 1; i < entries.length; i++) {
    const key = prefix << 8 | entries[i], longer = codes.get(key);
    if (longer !== undefined) { prefix = longer; continue; }
    put(prefix);
    prefix = entries[i];
    if (next < MOST_CODES) {
      if (next === 1 << width) width++;
      codes.set(key, next++);
    } else {
      put(CLEAR);
      codes.clear();
      [width, next] = [9, END + 1];
    }
  }
  put(prefix);
  if (next === 1 << width && next < MOST_CODES) width++;  // a reader has as many codes by now
  put(END);
  if (bits) bytes.push(buffer & 255);
  const blocks = [];
  for (let k = 0; k < bytes.length; k += 255) {
    const block = bytes.slice(k, k + 255);
    blocks.push(Uint8Array.of(block.length, ...block));
  }
  return [...blocks, Uint8Array.of(0)];
}

/** A GIF that repeats for ever, of `count` pictures.
 *
 * `pixelsOf(k)` returns the pixels (0xAABBGGRR) of a picture, `delayOf(k)` its duration in hundredths of a second;
 * before each picture `onPicture(k)` is called, and the page handles its events.
 */
async function gifOf(width, height, count, pixelsOf, delayOf, onPicture) {
  const two = number => [number & 255, number >> 8], letters = text => [...text].map(letter => letter.charCodeAt(0));
  const sampled = Math.min(count, SAMPLED);
  const samples = Array.from({ length: sampled }, (_, k) => pixelsOf(Math.floor(k * count / sampled)));
  const { colours, entryOf } = paletteOf(samples), table = new Uint8Array(3 * 256);
  colours.forEach((channels, k) => table.set(channels, 3 * k));
  const parts = [Uint8Array.of(...letters("GIF89a"), ...two(width), ...two(height), 0xf7, 0, 0), table,
    Uint8Array.of(0x21, 0xff, 11, ...letters("NETSCAPE2.0"), 3, 1, 0, 0, 0)];
  let before = null;
  for (let k = 0; k < count; k++) {
    onPicture(k);
    await new Promise(done => setTimeout(done, 0));
    const pixels = pixelsOf(k), entries = new Uint8Array(pixels.length);
    for (let i = 0; i < pixels.length; i++) entries[i] = before && before[i] === pixels[i] ? UNCHANGED : entryOf(pixels[i] & 0xffffff);
    before = pixels;
    parts.push(Uint8Array.of(0x21, 0xf9, 4, 1 << 2 | 1, ...two(delayOf(k)), UNCHANGED, 0),
      Uint8Array.of(0x2c, 0, 0, 0, 0, ...two(width), ...two(height), 0, 8), ...blocksOf(entries));
  }
  return new Blob([...parts, Uint8Array.of(0x3b)], { type: "image/gif" });
}
