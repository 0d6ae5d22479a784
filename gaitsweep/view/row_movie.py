"""A movie or a strip of poses of one row, drawn from its model's skeleton.

A row without a trace is simulated again.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from gaitsweep import near_miss
from gaitsweep.contract import Model
from gaitsweep.design.design import row_params
from gaitsweep.job import Job
from gaitsweep.job.load import stored_job
from gaitsweep.kinds.columns import gaits
from gaitsweep.plot import PlotError
from gaitsweep.plot.columns import rows_where, written
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.runs.prepare import prepare
from gaitsweep.table import WriteError, load, reason, replace_file
from gaitsweep.table.manifest import FIGURES
from gaitsweep.view.explorer.replay_groups import replayer_of
from gaitsweep.view.explorer.replays import Windows
from gaitsweep.view.movie import animation, movie_file, side_view
from gaitsweep.view.movie.animation import Clip, Drawn, Scene
from gaitsweep.view.movie.mujoco_movie import NoOpenGL, Painter, Rendered, RenderedBody, pixels

RENDERERS = ("auto", "mujoco", "matplotlib")
SIZE, STILL_SIZE = (960, 540), (1600, 560)  # pixels
_SIDES = (160, 4096)
_POSES = 6
_CYCLE_TIME = 1.6  # s that a cycle takes in a movie whose speed is not given
_MOST_FRAMES = 3000
_LEAST_DISTANCE = 1e-3  # a slower body has no speed in its title; heights of the body a cycle
_NAMED = 4  # quantities in a title
SIMULATED = ("settle", "fixed_time", "return_map", "ramp", "staircase")  # run kinds simulated again
_LAST_CYCLES = 4  # cycles at the end of a row that is simulated again, if its part is not given

OnMessage = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Motion:
    """Signals (n,) of a row by name, at the times `t` (n,) s.

    `values` are the row's parameters by name; `period` s is its model's nominal cycle; `gait` is its gait, or
    how it ended, and `row` names it.
    """

    model: Model
    values: Mapping[str, float]
    t: np.ndarray
    signals: Mapping[str, np.ndarray]
    period: float
    gait: str
    row: str

    def title(self, clip: Clip, lift: float) -> str:
        """Format the model, its gait, the mean speed of a clip, the factor on its lift, and the row."""
        distance = float(np.hypot(*(clip.camera[-1] - clip.camera[0])))
        speed = distance / float(clip.t[-1] - clip.t[0])
        moves = speed * self.period > _LEAST_DISTANCE * side_view.bounds(clip.skeleton, clip.camera)[1]
        motion = f"{self.gait}{f' at {speed:.2g} m/s' if moves else ''}".strip()
        motion += f" (lift drawn {lift:.3g} times as high)" if lift != 1.0 else ""
        return f"{self.model.name}{f', {motion}' if motion else ''}; {self.row}"

    def at(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """The signals at times (k,) s, interpolated linearly; angles and contacts from the nearest sample."""
        edges = 0.5 * (self.t[1:] + self.t[:-1])
        nearest = np.searchsorted(edges, times)
        circular = {quantity.name for quantity in self.model.signals if quantity.circular}
        return {
            name: signal[nearest]
            if name in circular or name.startswith("contact_")
            else np.interp(times, self.t, signal)
            for name, signal in self.signals.items()
        }

    def contact(self, limbs: int) -> np.ndarray:
        """Ground contact of each limb, (n, limbs), 1 on the ground.

        Raises:
            PlotError: the model has no such signal for a limb.
        """
        names = [f"contact_{i + 1}" for i in range(limbs)]
        for name in names:
            if name not in self.signals:
                raise PlotError(f"{self.model.name} has no signal {name}, which would show ground contact.")
        return np.array([self.signals[name] for name in names]).reshape(limbs, len(self.t)).T


def read_motion(
    directory: str | Path,
    row: int,
    trust: bool = False,
    start: float | None = None,
    seconds: float | None = None,
    renderer: str = "auto",
) -> Motion:
    """Read a row of a trace, or simulate a row of another run again as the explorer does.

    Args:
        directory: the result directory.
        row: the number of the row.
        trust: as for `gaitsweep.models.find_of_table`.
        start, seconds: the part of a row that is simulated again, s; by default its last cycles, or seconds.
        renderer: the one asked for.

    Raises:
        PlotError: the run kind has no motion, the model cannot be drawn so, the table lacks signals, or there
            is no such row, or no motion of it.
        TableError, JobError: the directory cannot be read, or its job.
    """
    directory = Path(directory)
    table = load(directory)
    fields = table.attrs["job"]
    kind = fields.get("run", {}).get("kind", "another kind")
    if kind not in ("trace", *SIMULATED) or {"search", "sensitivity"} & set(fields):
        raise PlotError(
            f"{directory} contains {kind} rows, which have no motion: use a run of kind trace"
            f"{', or gaitsweep explore' if kind == 'continuation' else ''}."
        )
    part = _samples(table, directory, row)
    job = stored_job(table.attrs, trust)
    rows = job.design
    parameters, _ = rows.values(row, row + 1)
    values = {name: float(value[0]) for name, value in parameters.items()}
    _check_drawable(rows.model, values, renderer)
    names = [quantity.name for quantity in rows.model.signals]
    ended = str(part["status"].iloc[-1])
    if kind == "trace":
        t, signals = _recorded(part, directory, names)
        # that of the row's end; tables of older versions have none
        gait = _gait_of(part.iloc[-1]) if "gait" in part.columns and job.run.moved is None else ""
    else:
        t, signals, gait = _simulated(job, part, row, start, seconds)
    finite = np.isfinite(np.stack([t, *signals.values()])).all(axis=0)
    if np.count_nonzero(finite) < 2:
        raise PlotError(f"Row {row} of {directory} has no recorded motion: it ended with status {ended}.")
    set_to = [written(table, name, part[name].iloc[0]) for name in rows.names if name in part.columns]
    return Motion(
        model=rows.model,
        values=values,
        t=t[finite],
        signals={name: values[finite] for name, values in signals.items()},
        period=float(rows.model.period(row_params(rows, row))),
        gait=gait,
        row=f"row {row}{': ' if set_to else ''}{', '.join(set_to[:_NAMED])}",
    )


def _check_drawable(model: Model, values: Mapping[str, float], renderer: str) -> None:
    """Refuse a model that cannot be drawn, before its row is simulated."""
    if type(model).skeleton is Model.skeleton:
        raise PlotError(
            f"{model.name} has no `skeleton` to draw: define one, as docs/own_model.md shows under "
            "`See it move`."
        )
    if renderer == "mujoco" and model.mjcf(values) is None:
        raise PlotError(f"{model.name} has no MJCF, which MuJoCo needs: use --renderer matplotlib.")


def _recorded(
    part: pd.DataFrame, directory: Path, names: list[str]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (n,) s and signals (n,) of a row of a trace."""
    missing = [name for name in names if name not in part.columns]
    if missing:
        some = ", ".join(missing[:_NAMED]) + (", ..." if len(missing) > _NAMED else "")
        raise PlotError(
            f"The table of {directory} lacks the signals {some}: run its job again into another directory."
        )
    part = part.sort_values("t")
    return part["t"].to_numpy(float), {name: part[name].to_numpy(float) for name in names}


def _simulated(
    job: Job, part: pd.DataFrame, row: int, start: float | None, seconds: float | None
) -> tuple[np.ndarray, dict[str, np.ndarray], str]:
    """Times (n,) s and signals (n,) of a row simulated again, and its gait, or its status if it has none.

    A row that failed at its start has no times.
    """
    times = part["t_end" if "t_end" in part.columns else "t"].to_numpy(float)
    end = float(times[np.isfinite(times)].max(initial=0.0))
    if end == 0.0:
        return np.zeros(0), {}, ""
    context = prepare(job)
    replayer = replayer_of(context, np.array([row]))
    first = start
    if first is None:
        length = _LAST_CYCLES * float(replayer.periods[0]) if seconds is None else seconds
        first = max(0.0, end - length)
    if not 0.0 <= first < end:
        raise PlotError(f"{first:g} s is outside the row, which goes from 0 to {end:g} s.")
    last = end if seconds is None else min(end, first + seconds)
    (replayed,) = replayer.replayed(Windows(last - first, first))
    kept = replayed.t <= last * (1.0 + 1e-9)
    record = part.iloc[max(int(np.count_nonzero(times <= last * (1.0 + 1e-9))) - 1, 0)]
    if "gait" not in part.columns and replayed.gait != -1:  # crossings of a return map
        record = {**record, "gait": gaits(context.model, np.array([replayed.gait]))[0]}
    signals = {key: values[kept] for key, values in replayed.signals.items()}
    return replayed.t[kept], signals, _gait_of(record) or str(record["status"]).replace("_", " ")


def _gait_of(record: Mapping[str, Any] | pd.Series) -> str:
    """The gait of a record; empty if it has none."""
    gait = record.get("gait")
    return "" if gait is None or pd.isna(gait) or gait == "none" else str(gait)


def _samples(table: pd.DataFrame, directory: Path, row: int) -> pd.DataFrame:
    rows = int(table.attrs["manifest"]["rows"])
    if not 0 <= row < rows:
        allowed = f"rows 0 to {rows - 1}" if rows > 1 else "only row 0"
        raise PlotError(f"Row {row} does not exist: {directory} has {allowed}.")
    part = rows_where(table, table["row"] == row)
    if part.empty:
        raise PlotError(f"Row {row} of {directory} has not run yet: run the job again to continue it.")
    return part


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
    motion = read_motion(directory, row, trust, start, seconds, renderer)
    start = float(motion.t[0]) if start is None else start
    speed = usual_speed(motion.period) if speed is None else speed
    end = _end(motion, start, seconds, on_message)
    count = int((end - start) / speed * fps * (1.0 + 1e-9)) + 1
    if not 2 <= count <= _MOST_FRAMES:
        raise PlotError(
            f"The movie would have {count} frame{'s' * (count != 1)}, but 2 to {_MOST_FRAMES} are allowed: "
            "change --seconds, --speed or --fps."
        )
    times = start + np.arange(count) * (speed / fps)

    def counted(frames: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
        for number, frame in enumerate(frames):
            yield frame
            if on_progress is not None:
                on_progress(number + 1, count)

    with (
        _prepared(motion, times, _pace(speed), renderer, lift, on_message) as (clip, scene),
        contextlib.closing(animation.frames(clip, size, scene)) as frames,
    ):
        colours = [*limb_colours(clip.skeleton.limbs), side_view.SWING]
        _write(target, lambda: movie_file.save(target, counted(frames), fps, colours), own=out is None)
    return target


def write_still(
    directory: str | Path,
    out: str | Path | None = None,
    *,
    row: int = 0,
    at: float = 0.0,
    size: tuple[int, int] = STILL_SIZE,
    renderer: str = "auto",
    lift: float = 1.0,
    trust: bool = False,
    on_message: OnMessage | None = None,
) -> Path:
    """Write a PNG of six poses over the cycle that begins at a time.

    Args:
        directory, row, size, renderer, lift, trust, on_message: as for `write_movie`.
        out: .png; `figures/poses_rowN.png` in the directory by default.
        at: time at which the cycle begins, s.

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
    motion = read_motion(directory, row, trust, at, renderer=renderer)
    end = _end(motion, at, motion.period, on_message)
    times = np.linspace(at, end, _POSES, endpoint=False)
    with _prepared(motion, times, "", renderer, lift, on_message) as (clip, scene):
        figure = animation.still(clip, size, scene)
    _write(
        target,
        lambda: replace_file(target, lambda file: figure.savefig(file, format="png", dpi=figure.dpi)),
        own=out is None,
    )
    return target


def _check(size: tuple[int, int], renderer: str, lift: float) -> None:
    low, high = _SIDES
    if not all(low <= side <= high for side in size):
        raise PlotError(f"--size is {size[0]}x{size[1]}, but each side must have {low} to {high} pixels.")
    if renderer not in RENDERERS:
        raise PlotError(f"{renderer} is not a renderer{near_miss.suggestion(renderer, RENDERERS)}")
    if not 0.0 < lift < np.inf or (lift != 1.0 and renderer == "mujoco"):
        raise PlotError(f"--lift is {lift:g}, but must be above 0, and 1 with --renderer mujoco.")


def _target(directory: str | Path, out: str | Path | None, name: str) -> Path:
    return Path(directory) / FIGURES / name if out is None else Path(out)


def _write(target: Path, write: Callable[[], object], *, own: bool) -> None:
    """Write a file; the folder of one of the directory's `own` figures is made."""
    try:
        if own:
            target.parent.mkdir(exist_ok=True)
        write()
    except OSError as error:
        raise WriteError(f"{target} could not be written: {reason(error)}.") from error


def _end(motion: Motion, start: float, seconds: float | None, on_message: OnMessage | None) -> float:
    """End of the shown part, s, at most the end of the trace."""
    first, last = float(motion.t[0]), float(motion.t[-1])
    if not first <= start < last:
        raise PlotError(f"{start:g} s is outside the trace, which goes from {first:g} to {last:g} s.")
    if seconds is None:
        return last
    # the last sample of a part lies up to a sample before its end
    if start + seconds > last + 1.01 * float(motion.t[-1] - motion.t[-2]) and on_message is not None:
        on_message(f"The trace, and with it the movie, ends at {last:g} s.")
    return min(start + seconds, last)


def usual_speed(period: float) -> float:
    """A round speed at which the eye can follow a cycle (s)."""
    wanted = np.log(period / _CYCLE_TIME)
    heads = np.array([1.0, 2.0, 2.5, 5.0])
    rounds = (heads * 10.0 ** np.arange(-9.0, 10.0)[:, None]).ravel()
    return float(rounds[np.abs(np.log(rounds) - wanted).argmin()])


def _pace(speed: float) -> str:
    if abs(speed - 1.0) < 1e-3:
        return "real time"
    return f"{speed:.3g} times faster" if speed > 1.0 else f"{1.0 / speed:.3g} times slower"


@contextlib.contextmanager
def _prepared(
    motion: Motion, times: np.ndarray, pace: str, renderer: str, lift: float, on_message: OnMessage | None
) -> Iterator[tuple[Clip, Drawn]]:
    """Clip at some times, and the drawing function of the body."""
    signals = motion.at(times)
    skeleton = motion.model.skeleton(motion.values, signals)
    if skeleton is None:
        raise PlotError(f"{motion.model.name} has no skeleton of this row: its function returned None.")
    if lift != 1.0:
        skeleton, renderer = side_view.lifted(skeleton, lift), "matplotlib"
    heading = side_view.heading(skeleton)
    contact = motion.contact(len(skeleton.limbs))
    clip = Clip(times, side_view.turned(skeleton, heading), motion.t, contact, motion.period, "", pace)
    clip = dataclasses.replace(clip, title=motion.title(clip, lift))
    mjcf = None if renderer == "matplotlib" else motion.model.mjcf(motion.values)
    if mjcf is None:
        yield clip, animation.side_view
        return
    nq = sum(key.startswith("q_") for key in signals)
    body = RenderedBody(mjcf, np.stack([signals[f"q_{i}"] for i in range(nq)], axis=1), heading)
    painters: list[Painter] = []
    refused = False

    def rendered(axes: Axes, clip: Clip, named: bool) -> Scene:
        nonlocal refused
        try:
            if not painters and not refused:
                painters.append(Painter(body, clip.skeleton, clip.camera, pixels(axes)))
        except NoOpenGL as error:
            if renderer == "mujoco":
                raise PlotError(f"{error}: use --renderer matplotlib.") from error
            refused = True
            if on_message is not None:
                on_message(f"{error}: Matplotlib draws it instead.")
        return Rendered(axes, painters[0]) if painters else animation.side_view(axes, clip, named)

    try:
        yield clip, rendered
    finally:
        for painter in painters:
            painter.close()
