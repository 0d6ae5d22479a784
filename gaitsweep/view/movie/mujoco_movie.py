"""A body rendered by MuJoCo without a display, if this machine has a suitable OpenGL."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.image import AxesImage

from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.skeleton import Skeleton
from gaitsweep.view.movie.side_view import above_ground, bounds, round_step

BACKENDS = ("egl", "osmesa")  # OpenGL without a display; the first that works is used
_PATIENCE = 90.0  # s for a frame; the first one includes the start of Python and MuJoCo
_PAINTER = Path(__file__).with_name("mujoco_painter.py")


class NoOpenGL(PlotError):
    """MuJoCo cannot render on this machine; the message gives the reason."""


@dataclasses.dataclass(frozen=True)
class RenderedBody:
    """The input of MuJoCo: an MJCF, its qpos (n, nq), m and rad, and the heading (rad) from the x axis."""

    mjcf: str
    qpos: Float[np.ndarray, "frames coordinates"]
    heading: float = 0.0


class Painter:
    """A process that renders the frames of a body in order."""

    def __init__(
        self,
        body: RenderedBody,
        skeleton: Skeleton,
        camera: Float[np.ndarray, "frames 2"],
        size: tuple[int, int],
    ) -> None:
        """Start the process and read its first frame.

        Args:
            body: what MuJoCo renders.
            skeleton: the same body as lines.
            camera: the centre of each frame, m.
            size: width and height, pixels.

        Raises:
            NoOpenGL: no OpenGL backend works.
        """
        self._shape = (size[1], size[0], 3)
        self._at = 0
        request = _request(body, skeleton, camera, size)
        refusals = []
        for backend in BACKENDS:
            self._process, self._log = _start(request, backend)
            try:
                self._picture = self._read()
                return
            except NoOpenGL as error:
                refusals.append(f"{backend}: {error}")
        raise NoOpenGL(f"MuJoCo cannot render here ({'; '.join(refusals)})")

    def picture(self, k: int) -> UInt8[np.ndarray, "height width 3"]:
        """The frame of sample k, RGB bytes; samples must be requested in order.

        Raises:
            PlotError: the process has ended.
        """
        while self._at < k:
            try:
                self._picture = self._read()
            except NoOpenGL as error:
                raise PlotError(
                    f"MuJoCo's renderer stopped after frame {self._at + 1} ({error}): "
                    "try again, or use --renderer matplotlib."
                ) from error
            self._at += 1
        return self._picture

    def close(self) -> None:
        """End the process; a second call does nothing."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._log):
            if stream is not None:
                stream.close()

    def _read(self) -> UInt8[np.ndarray, "height width 3"]:
        """The next frame; raises NoOpenGL with the last message of the process if there is none."""
        assert self._process.stdout is not None
        length = int(np.prod(self._shape))
        picture = bytearray()
        deadline = time.monotonic() + _PATIENCE
        while len(picture) < length:
            ready, _, _ = select.select([self._process.stdout], [], [], max(deadline - time.monotonic(), 0.0))
            pixels = os.read(self._process.stdout.fileno(), length - len(picture)) if ready else b""
            if not pixels:
                silence = f"no output within {_PATIENCE:.0f} s"
                reason = _last_message(self._process, self._log) if ready else silence
                self.close()
                raise NoOpenGL(reason)
            picture += pixels
        return np.frombuffer(bytes(picture), np.uint8).reshape(self._shape)


class Rendered:
    """The frames of a painter in axes."""

    def __init__(self, axes: Axes, painter: Painter) -> None:
        axes.set_axis_off()
        self._axes = axes
        self._painter = painter
        self._image: AxesImage | None = None

    def show(self, k: int) -> None:
        """Show sample k; samples must be shown in order."""
        picture = self._painter.picture(k)
        if self._image is None:
            self._image = self._axes.imshow(picture, aspect="auto", interpolation="nearest")
        self._image.set_data(picture)


def pixels(axes: Axes) -> tuple[int, int]:
    """Width and height of axes in their figure, pixels."""
    box = axes.get_window_extent()
    return max(round(box.width), 1), max(round(box.height), 1)


def _request(
    body: RenderedBody, skeleton: Skeleton, camera: Float[np.ndarray, "frames 2"], size: tuple[int, int]
) -> bytes:
    """The .npz that the painter reads."""
    half, tall, _ = bounds(skeleton, camera)
    cosine, sine = np.cos(body.heading), np.sin(body.heading)
    to_walking_direction = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    file = io.BytesIO()
    np.savez(
        file,
        mjcf=np.array(body.mjcf),
        qpos=body.qpos,
        middle=above_ground(skeleton, camera) @ to_walking_direction,
        heading=body.heading,
        size=np.array(size),
        extent=np.array([half, tall]),
        square=round_step(0.2 * tall),
        colours=np.array([to_rgb(colour) for colour in limb_colours(skeleton.limbs)]),
    )
    return file.getvalue()


def _start(request: bytes, backend: str) -> tuple[subprocess.Popen[bytes], io.BufferedRandom]:
    """The running painter; its messages go to an unnamed file."""
    environment = {**os.environ, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    log = tempfile.TemporaryFile()  # noqa: SIM115 - the painter closes it
    # run as a file, it does not import this package; -P hides the files beside it
    command = [sys.executable, "-P", str(_PAINTER)]
    process = subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, bufsize=0
    )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # the process has ended, and its last message gives the reason
        process.stdin.write(request)
    with contextlib.suppress(BrokenPipeError):
        process.stdin.close()
    return process, log


def _last_message(process: subprocess.Popen[bytes], log: io.BufferedRandom) -> str:
    """The last line of a process that has ended, else its exit code."""
    code = process.wait()
    log.seek(0)
    lines = [line.strip() for line in log.read().decode(errors="replace").splitlines() if line.strip()]
    return lines[-1].rstrip(".") if lines else f"it ended with code {code}"
