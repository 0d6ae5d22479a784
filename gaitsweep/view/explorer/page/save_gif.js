// The stretch on view as an animated GIF, by `gif.js`.

const GIF_SIZE = [640, 360], GIF_CAPTION = 28;  // pixels of a body's drawing and of the line above it
const MOST_PICTURES = 300;                      // of a GIF, at 25 a second or fewer

/** Save the stretch on view, at the speed on view, as an animated GIF. */
async function saveGif() {
  if (!motion || !picturesOf(motion)) return;  // no body is drawn
  const button = $("save-gif"), speed = clock.speed, length = lengthOf(motion), [, owner] = walkFor(chosen);
  const sides = [[motion, owner], ...(beside ? [[beside, walkFor(other)[1]]] : [])];
  const delay = Math.max(4, Math.ceil(100 * length / speed / MOST_PICTURES));  // hundredths of a second
  const count = Math.max(2, Math.round(100 * length / speed / delay)), steps = sides[0][0].loops ? count : count - 1;
  const picture = document.createElement("canvas"), part = document.createElement("canvas");
  [part.width, part.height] = GIF_SIZE;
  [picture.width, picture.height] = [GIF_SIZE[0] * sides.length, GIF_SIZE[1] + GIF_CAPTION];
  const pen = picture.getContext("2d", { willReadFrequently: true });
  pen.font = "14px system-ui, DejaVu Sans, sans-serif";
  pen.textBaseline = "middle";
  const pixelsOf = k => {
    pen.fillStyle = shade.paper;
    pen.fillRect(0, 0, picture.width, picture.height);
    sides.forEach(([stretch, i], side) => {
      const at = k / steps * length, left = side * GIF_SIZE[0];
      if (side) paintBeside(part, stretch, at, at); else paintBody(part, stretch, at, 0);
      pen.drawImage(part, left, GIF_CAPTION);
      pen.fillStyle = shade.ink;
      pen.fillText(`${data.model}: ${outcomeOf(i).name}; ${plain(titleHtml(i))}`, left + 8, GIF_CAPTION / 2, GIF_SIZE[0] - 16);
    });
    return new Uint32Array(pen.getImageData(0, 0, picture.width, picture.height).data.buffer);
  };
  const name = nameOf(owner), show = text => $("copied").textContent = text;
  button.disabled = true;
  try {
    const delayOf = k => k === count - 1 && !sides[0][0].loops ? 60 : delay;
    const file = await gifOf(picture.width, picture.height, count, pixelsOf, delayOf, k => show(`GIF: picture ${k + 1} of ${count}`));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(file);
    link.download = `${data.name}_${name.replace(/[^0-9a-z]+/gi, "_")}.gif`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    $("live").textContent = show(`GIF of ${name} saved, ${(file.size / 1e6).toFixed(1)} MB`);
  } finally { button.disabled = false; }
}
