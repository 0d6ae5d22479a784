"""Movies on disk: GIF by Pillow, MP4 by the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image

from gaitsweep.plot.columns import PlotError
from gaitsweep.table import replace_file

_EXACT = 64  # colours of a GIF that are kept as they are
FORMATS = (".gif", ".mp4")


def require(path: Path, fps: float) -> None:
    """Refuse, before anything is drawn, what could not be written.

    Raises:
        PlotError: another format than .gif or .mp4, pictures too fast for GIF, no ffmpeg for MP4.
    """
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise PlotError(f"{path} is no movie's name: end it with {' or '.join(FORMATS)}.")
    if kind == ".gif" and fps > 50:
        raise PlotError(f"--fps is {fps:g}, but a GIF shows 50 pictures a second at most.")
    if kind == ".mp4":
        _ffmpeg()


def save(path: Path, frames: Iterator[np.ndarray], fps: float) -> None:
    """Write a movie, whole or not at all.

    Args:
        path: where it shall stand, .gif or .mp4; its folder exists.
        frames: RGB bytes (height, width, 3), as many as there are.
        fps: pictures a second.

    Raises:
        PlotError: as `require`, or ffmpeg refuses.
        OSError: the file cannot be written; what stood there stands.
    """
    require(path, fps)
    if path.suffix.lower() == ".gif":
        replace_file(path, lambda file: _gif(file, frames, fps))
    else:
        replace_file(path, lambda file: _mp4(file.name, frames, fps))


def _gif(file: BinaryIO, frames: Iterator[np.ndarray], fps: float) -> None:
    """All pictures in the same colours, so that what does not move stays the same to the bit."""
    first = next(frames)
    palette = _palette(first)

    def painted(frame: np.ndarray) -> Image.Image:
        return Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)

    images = map(painted, frames)
    options = {"save_all": True, "append_images": images, "duration": 1000.0 / fps, "loop": 0, "optimize": False}
    painted(first).save(file, format="GIF", **options)


def _palette(picture: np.ndarray) -> Image.Image:
    """256 colours for pictures like this one: its most frequent ones as they are, means of the others."""
    colours, counts = np.unique(picture.reshape(-1, 3), axis=0, return_counts=True)
    exact = colours[np.argsort(-counts, kind="stable")[:_EXACT]]
    means = Image.fromarray(picture).quantize(256 - _EXACT, dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*exact.ravel().tolist(), *means])
    return palette


def _ffmpeg() -> str:
    """The program of imageio-ffmpeg."""
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports] (an extra)

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise PlotError(
            "An MP4 needs ffmpeg: pip install 'gaitsweep[video]' (imageio-ffmpeg), or write a .gif."
        ) from error


def _mp4(target: str, frames: Iterator[np.ndarray], fps: float) -> None:
    first = next(frames)
    height, width, _ = first.shape
    # yuv420p, which every player reads, has one colour for 2 x 2 pixels
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"
    command = [
        _ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{fps:g}", "-i", "-", "-vf", even, "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20",
        "-movflags", "+faststart", "-f", "mp4", target,
    ]  # fmt: skip
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdin is not None
    try:
        with contextlib.suppress(BrokenPipeError):  # it has ended, and says why
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(frame.tobytes())
        _, words = process.communicate()
    except BaseException:
        process.kill()
        process.wait()
        raise
    if process.returncode != 0:
        last = words.decode(errors="replace").strip().splitlines()[-1:] or [f"code {process.returncode}"]
        raise PlotError(f"ffmpeg could not write the movie: {last[0].rstrip('.')}.")
