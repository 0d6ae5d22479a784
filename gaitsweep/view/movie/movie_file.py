"""Movie files: GIF by Pillow, MP4 by the ffmpeg program of imageio-ffmpeg."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Int, Real, UInt8
from matplotlib.colors import to_rgb
from PIL import Image

from gaitsweep.plot.columns import PlotError
from gaitsweep.table import replace_file

_COLOURS = 64  # of a GIF: more make a larger file, and look the same
_EXACT_COLOURS = 48  # those that are stored exactly: the others are shades along the edges of what is drawn
_SAME_COLOUR_WITHIN = 8  # of 255; Pillow looks colours up in steps of 4, so it may confuse colours this near
_RGB_WEIGHTS = np.array([65536, 256, 1], np.uint32)  # of the channels in a colour as one number
FORMATS = (".gif", ".mp4")


def require(path: Path, fps: float) -> None:
    """Refuse a movie that cannot be written, before drawing it.

    Raises:
        PlotError: the format is neither .gif nor .mp4, the frame rate is none of a GIF, or MP4 lacks ffmpeg.
    """
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise PlotError(f"{path} is not a valid name for a movie: it must end with {' or '.join(FORMATS)}.")
    if kind == ".gif" and not 0.01 <= fps <= 50.0:
        raise PlotError(f"--fps is {fps:g}, but a GIF can have 0.01 to 50 frames per second.")
    if kind == ".mp4":
        _ffmpeg()


def save(
    path: Path,
    frames: Iterator[UInt8[np.ndarray, "height width 3"]],
    count: int,
    fps: float,
    colours: Sequence[str] = (),
) -> None:
    """Write a movie; the file is replaced when all frames are written.

    Args:
        path: the file, .gif or .mp4.
        frames: RGB bytes.
        count: number of frames.
        fps: frames per second.
        colours: colours that a GIF has exactly, among its 64.

    Raises:
        PlotError: as for `require`, or ffmpeg fails.
        OSError: the file cannot be written.
    """
    require(path, fps)
    if path.suffix.lower() == ".gif":
        # a GIF has durations in hundredths of a second: they differ by one, so that none adds up to an error
        ends = np.round(100.0 / fps * np.arange(count + 1))
        durations = (10.0 * np.diff(ends)).tolist()
        replace_file(path, lambda file: _gif(file, frames, durations, colours))
    else:
        replace_file(path, lambda file: _mp4(file.name, frames, fps))


def _gif(
    file: BinaryIO,
    frames: Iterator[UInt8[np.ndarray, "height width 3"]],
    durations: list[float],
    colours: Sequence[str],
) -> None:
    """Write all frames, of some durations (ms), with one palette, so that unchanged pixels are equal.

    Pillow then stores the rectangle that has changed, and with `optimize` the colours that occur in it.
    """
    first = next(frames)
    palette = _palette(first, colours)

    def in_palette(frame: UInt8[np.ndarray, "height width 3"]) -> Image.Image:
        return Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)

    options = {
        "append_images": map(in_palette, frames),
        "duration": durations,
        "loop": 0,
        "optimize": True,
    }
    in_palette(first).save(file, format="GIF", save_all=True, **options)


def _palette(picture: UInt8[np.ndarray, "height width 3"], colours: Sequence[str]) -> Image.Image:
    """The palette: some colours, the most frequent ones of a picture, and means of its other colours."""
    codes, counts = np.unique(picture.astype(np.uint32) @ _RGB_WEIGHTS, return_counts=True)
    most_frequent = np.argsort(-counts, kind="stable")[: 4 * _EXACT_COLOURS]
    frequent = codes[most_frequent, None] // _RGB_WEIGHTS % 256
    means = Image.fromarray(picture).quantize(_COLOURS, dither=Image.Dither.NONE).getpalette() or []
    requested = np.round(255 * np.array([to_rgb(colour) for colour in colours])).reshape(-1, 3)
    exact = _distinct([*requested, *frequent])[:_EXACT_COLOURS]
    entries = _distinct([*exact, *np.reshape(means, (-1, 3))])[:_COLOURS]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.array(entries, np.uint8).ravel().tolist())
    return palette


def _distinct(colours: Sequence[Real[np.ndarray, 3]]) -> list[Int[np.ndarray, 3]]:
    """The colours without those that are near an earlier one."""
    distinct: list[Int[np.ndarray, 3]] = []
    for colour in colours:
        if all(np.abs(colour.astype(int) - other).max() > _SAME_COLOUR_WITHIN for other in distinct):
            distinct.append(colour.astype(int))
    return distinct


def _ffmpeg() -> str:
    """The path of imageio-ffmpeg's program.

    Raises:
        PlotError: it is not installed.
    """
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports] (an extra)

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise PlotError(
            "An MP4 needs ffmpeg: run pip install 'gaitsweep[video]' (imageio-ffmpeg), or write a .gif."
        ) from error


def _mp4(target: str, frames: Iterator[UInt8[np.ndarray, "height width 3"]], fps: float) -> None:
    """Write frames through ffmpeg, whose exit code and message `imageio_ffmpeg.write_frames` would hide."""
    first = next(frames)
    height, width, _ = first.shape
    # yuv420p, which every player reads, has one colour for 2 x 2 pixels
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"
    command = [
        _ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-",
        "-vf", even, "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20",
        "-movflags", "+faststart", "-f", "mp4", target,
    ]  # fmt: skip
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdin is not None
    try:
        with contextlib.suppress(BrokenPipeError):  # ffmpeg has ended, and its message gives the reason
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
        _, messages = process.communicate()
    except BaseException:
        process.kill()
        process.wait()
        raise
    if process.returncode != 0:
        lines = messages.decode(errors="replace").strip().splitlines()
        reason = lines[-1].rstrip(".") if lines else f"code {process.returncode}"
        raise PlotError(f"ffmpeg could not write the movie: {reason}.")
