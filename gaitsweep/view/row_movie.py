"""A movie or a strip of poses of one row, drawn from its model's skeleton."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes

from gaitsweep import near_miss
from gaitsweep.dynamics.ground import chooses_uneven, heights_of_model
from gaitsweep.plot import PlotError
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.table import WriteError, reason, replace_file
from gaitsweep.table.manifest import FIGURES
from gaitsweep.view.movie import animation, movie_file, side_view
from gaitsweep.view.movie.animation import Clip, DrawBody, Scene
from gaitsweep.view.movie.mujoco_movie import NoOpenGL, Painter, Rendered, RenderedBody, pixels
from gaitsweep.view.row_motion import RowMotion, read_motion

RENDERERS = ("auto", "mujoco", "matplotlib")
SIZE, STILL_SIZE = (960, 540), (1600, 560)  # pixels
_PIXEL_RANGE = (160, 4096)
_POSES = 6
_CYCLE_TIME = 1.6  # s that a cycle takes in a movie whose speed is not given
_MOST_PLACES = 20_000  # of the drawn ground
_MAX_FRAMES = 3000

OnMessage = Callable[[str], None]


def write_movie(
    directory: str | Path,
    out: str | Path | None = None,
    *,
    row: int = 0,
    start: float | None = None,
    seconds: float | None = None,
    speed: float | None = None,
    fps: float = 25.0,
    size: tuple[int, int] = SIZE,
    renderer: str = "auto",
    lift: float = 1.0,
    trust: bool = False,
    on_progress: Callable[[int, int], None] | None = None,
    on_message: OnMessage | None = None,
) -> Path:
    """Write a movie of one row walking.

    Args:
        directory: a result directory, of a run of kind trace, settle, fixed_time, return_map, ramp or
            staircase.
        out: .gif or .mp4; `figures/animation_rowN.gif` in the directory by default.
        row: the number of the row.
        start, seconds: start and length of the part of the row, s; by default a whole trace, or the last
            cycles of a row that is simulated again.
        speed: speed relative to real time; by default a cycle takes about 1.6 s.
        fps: frames per second.
        size: width and height, pixels.
        renderer: mujoco, matplotlib, or auto: MuJoCo if the model and this machine support it.
        lift: factor on the drawn height of feet over the ground; 1 with MuJoCo.
        trust: as for `gaitsweep.models.find_of_table`.
        on_progress: callback with the numbers of drawn frames and of all frames.
        on_message: callback with sentences about deviations from the request.

    Returns:
        The file.

    Raises:
        PlotError, TableError, JobError: the request cannot be fulfilled.
        WriteError: the file cannot be written.
    """
    _check(size, renderer, lift)
    for name, value in (("speed", speed), ("fps", fps), ("seconds", seconds)):
        if value is not None and not 0.0 < value < np.inf:
            raise PlotError(f"--{name} is {value:g}, but must be above 0.")
    target = _target(directory, out, f"animation_row{row}.gif")
    movie_file.require(target, fps)
    motion = read_motion(directory, row, start, seconds, renderer=renderer, trust=trust)
    start = float(motion.t[0]) if start is None else start
    speed = usual_speed(motion.period) if speed is None else speed
    end = _end(motion, start, seconds, on_message)
    # a speed near 0 would give a number of frames that is infinite
    count = int(min((end - start) / speed * fps * (1.0 + 1e-9), 1e15)) + 1
    if not 2 <= count <= _MAX_FRAMES:
        raise PlotError(
            f"The movie would have {count} frame{'s' * (count != 1)}, but 2 to {_MAX_FRAMES} are allowed: "
            "change --seconds, --speed or --fps."
        )
    times = start + np.arange(count) * (speed / fps)
    with (
        _prepared(motion, times, _pace(speed), renderer, lift, on_message) as (clip, draw_body),
        contextlib.closing(animation.frames(clip, size, draw_body)) as frames,
    ):
        colours = [*limb_colours(clip.skeleton.limbs), side_view.SWING]
        with _writing(target, own=out is None):
            movie_file.save(target, _counted(frames, count, on_progress), count, fps, colours)
    return target


def _counted(
    frames: Iterator[UInt8[np.ndarray, "height width 3"]],
    count: int,
    on_progress: Callable[[int, int], None] | None,
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """The `count` frames of a movie; progress is reported after each."""
    for number, frame in enumerate(frames):
        yield frame
        if on_progress is not None:
            on_progress(number + 1, count)


def write_still(
    directory: str | Path,
    out: str | Path | None = None,
    *,
    row: int = 0,
    at: float | None = None,
    size: tuple[int, int] = STILL_SIZE,
    renderer: str = "auto",
    lift: float = 1.0,
    trust: bool = False,
    on_message: OnMessage | None = None,
) -> Path:
    """Write a PNG of six poses over a cycle.

    Args:
        directory, row, size, renderer, lift, trust, on_message: as for `write_movie`.
        out: .png; `figures/poses_rowN.png` in the directory by default.
        at: time at which the cycle begins, s; by default, the last cycle of the row.

    Returns:
        The file.

    Raises:
        PlotError, TableError, JobError: the request cannot be fulfilled.
        WriteError: the file cannot be written.
    """
    _check(size, renderer, lift)
    target = _target(directory, out, f"poses_row{row}.png")
    if target.suffix.lower() != ".png":
        raise PlotError(f"{target} is not a valid name for a picture: it must end with .png.")
    motion = read_motion(directory, row, at, renderer=renderer, trust=trust)
    at = max(float(motion.t[0]), float(motion.t[-1]) - motion.cycle) if at is None else at
    end = _end(motion, at, motion.cycle, on_message)
    times = np.linspace(at, end, _POSES, endpoint=False)
    with _prepared(motion, times, "", renderer, lift, on_message) as (clip, draw_body):
        figure = animation.still(clip, size, draw_body)
    with _writing(target, own=out is None):
        replace_file(target, lambda file: figure.savefig(file, format="png", dpi=figure.dpi))
    return target


def _check(size: tuple[int, int], renderer: str, lift: float) -> None:
    """Refuse a size (pixels), a renderer or a lift that is not allowed."""
    low, high = _PIXEL_RANGE
    if not all(low <= side <= high for side in size):
        raise PlotError(f"--size is {size[0]}x{size[1]}, but each side must have {low} to {high} pixels.")
    if renderer not in RENDERERS:
        raise PlotError(f"{renderer} is not a renderer{near_miss.suggestion(renderer, RENDERERS)}")
    if not 0.0 < lift < np.inf or (lift != 1.0 and renderer == "mujoco"):
        raise PlotError(f"--lift is {lift:g}, but must be above 0, and 1 with --renderer mujoco.")


def _target(directory: str | Path, out: str | Path | None, name: str) -> Path:
    """The file to write: `out`, or by default `name` in the figures of the result directory."""
    return Path(directory) / FIGURES / name if out is None else Path(out)


@contextlib.contextmanager
def _writing(target: Path, *, own: bool) -> Iterator[None]:
    """A context in which a file is written; the folder of one of the directory's `own` figures is made."""
    try:
        if own:
            target.parent.mkdir(exist_ok=True)
        yield
    except OSError as error:
        raise WriteError(f"{target} could not be written: {reason(error)}.") from error


def _end(motion: RowMotion, start: float, seconds: float | None, on_message: OnMessage | None) -> float:
    """End of the shown part, s, at most the end of the trace.

    Raises:
        PlotError: the part begins outside the trace.
    """
    first, last = float(motion.t[0]), float(motion.t[-1])
    if not first <= start < last:
        raise PlotError(f"{start:g} s is outside the trace, which goes from {first:g} to {last:g} s.")
    if seconds is None:
        return last
    # the last sample of a part lies up to a sample before its end
    if start + seconds > last + 1.01 * float(motion.t[-1] - motion.t[-2]) and on_message is not None:
        on_message(f"The motion of the row, and with it the figure, ends at {last:g} s.")
    return min(start + seconds, last)


def usual_speed(period: float) -> float:
    """A round speed, relative to real time, at which the eye can follow cycles of this nominal period (s).

    It is real time for a period that is no number above 0.
    """
    if not 0.0 < period < np.inf:
        return 1.0
    digits = np.array([1.0, 2.0, 2.5, 5.0])
    speeds = (digits * 10.0 ** np.arange(-9.0, 10.0)[:, None]).ravel()
    return float(speeds[np.abs(np.log(speeds) - np.log(period / _CYCLE_TIME)).argmin()])


def _pace(speed: float) -> str:
    """Format the speed of a movie relative to real time."""
    if abs(speed - 1.0) < 1e-3:
        return "real time"
    return f"{speed:.3g} times faster" if speed > 1.0 else f"{1.0 / speed:.3g} times slower"


@contextlib.contextmanager
def _prepared(
    motion: RowMotion,
    times: Float[np.ndarray, " frames"],
    pace: str,
    renderer: str,
    lift: float,
    on_message: OnMessage | None,
) -> Iterator[tuple[Clip, DrawBody]]:
    """A context with the clip at some times (s), and the function that draws the body.

    Raises:
        PlotError: the model has no skeleton of the row, or one that cannot be drawn; or MuJoCo, which does
            not have it, would draw uneven ground.
    """
    signals = motion.at(times)
    skeleton = motion.model.skeleton(motion.values, signals)
    if skeleton is None:
        raise PlotError(f"{motion.model.name} has no skeleton of this row: its function returned None.")
    points = side_view.points_of(skeleton)
    if not points.size or not np.isfinite(points).all():
        raise PlotError(
            f"{motion.model.name} has a skeleton that cannot be drawn: it has no points, or some that are "
            "not finite."
        )
    if not np.ptp(points, axis=1).any() and not points[..., 2].any():
        raise PlotError(
            f"{motion.model.name} has a skeleton that cannot be drawn: it is a point on the ground."
        )
    heading = side_view.heading(skeleton)
    contact = motion.contact(len(skeleton.limbs))
    clip = Clip(times, side_view.turned(skeleton, heading), motion.t, contact, motion.cycle, "", pace)
    clip = dataclasses.replace(clip, title=motion.title(clip, lift, heading), details=motion.details)
    places = _places(clip)
    heights = heights_of_model(motion.model, motion.values, np.cos(heading) * places)
    if heights is not None:
        if chooses_uneven(motion.model):  # which the MJCF does not have
            if renderer == "mujoco":
                raise PlotError(
                    "MuJoCo draws the ground of the MJCF, but this row walks on uneven ground: "
                    "leave --renderer out."
                )
            renderer = "matplotlib"
        ground = np.column_stack([places, heights])
        clip = dataclasses.replace(clip, skeleton=dataclasses.replace(clip.skeleton, ground=ground))
    if lift != 1.0:
        clip = dataclasses.replace(clip, skeleton=side_view.lifted(clip.skeleton, lift))
        renderer = "matplotlib"
    mjcf = None if renderer == "matplotlib" else motion.model.mjcf(motion.values)
    if mjcf is None:
        yield clip, animation.side_view
        return
    nq = sum(name.startswith("q_") for name in signals)
    qpos = np.stack([signals[f"q_{number}"] for number in range(nq)], axis=1)
    drawing = _MujocoDrawing(RenderedBody(mjcf, qpos, heading), on_message, required=renderer == "mujoco")
    try:
        yield clip, drawing
    finally:
        drawing.close()


def _places(clip: Clip) -> Float[np.ndarray, " places"]:
    """Places (m) along the ground, closer than a hundredth of the body's width, that a clip may show.

    Of a body without a width, such as an upright rod, its height takes the place of the width.
    """
    half, height, _ = side_view.bounds(clip.skeleton, clip.camera)
    reach = 4.0 * max(half, height)
    ahead = clip.camera[:, 0]
    first, last = float(ahead.min()) - reach, float(ahead.max()) + reach
    places = (last - first) / (0.01 * (half or height))
    return np.linspace(first, last, int(min(_MOST_PLACES, places + 2)))


class _MujocoDrawing:
    """A `DrawBody` that renders a body by MuJoCo, or draws it by Matplotlib where there is no OpenGL."""

    def __init__(self, body: RenderedBody, on_message: OnMessage | None, *, required: bool) -> None:
        """Prepare the drawing; if MuJoCo is `required`, no OpenGL is an error."""
        self._body = body
        self._on_message = on_message
        self._required = required
        self._painter: Painter | None = None
        self._without_opengl = False

    def __call__(self, axes: Axes, clip: Clip, *, named: bool) -> Scene:
        """Draw the body of a clip; all axes show the frames of one painter.

        Raises:
            PlotError: MuJoCo is required, and there is no OpenGL.
        """
        if self._painter is None and not self._without_opengl:
            try:
                self._painter = Painter(self._body, clip.skeleton, clip.camera, pixels(axes))
            except NoOpenGL as error:
                if self._required:
                    raise PlotError(f"{error}: use --renderer matplotlib.") from error
                self._without_opengl = True
                if self._on_message is not None:
                    self._on_message(f"{error}: Matplotlib draws it instead.")
        if self._painter is None:
            return animation.side_view(axes, clip, named=named)
        return Rendered(axes, self._painter)

    def close(self) -> None:
        """End the process of the painter."""
        if self._painter is not None:
            self._painter.close()
