"""The motion of one row: recorded in a trace, or simulated again for other run kinds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.contract import Model
from gaitsweep.design.design import row_params
from gaitsweep.dynamics.gaits_by_footfalls import SHORTEST_CONTACT
from gaitsweep.job import Job
from gaitsweep.job.load import stored_job
from gaitsweep.kinds.columns import gaits
from gaitsweep.plot import PlotError
from gaitsweep.plot.column_labels import written
from gaitsweep.plot.columns import rows_where
from gaitsweep.plot.footprint_diagrams import contact_intervals, joined_stances
from gaitsweep.runs.prepare import prepare
from gaitsweep.skeleton import contact_signals
from gaitsweep.status import Status
from gaitsweep.table import load
from gaitsweep.view.explorer.replay_groups import replayer_of
from gaitsweep.view.explorer.replays import Windows
from gaitsweep.view.movie import side_view
from gaitsweep.view.movie.animation import Clip, middle

_LEAST_DISTANCE = 1e-3  # heights of the body a cycle: a slower body has no speed in its title
_NAMED = 4  # quantities in a title or a message
SIMULATED = ("settle", "fixed_time", "return_map", "ramp", "staircase")  # run kinds simulated again
_LAST_CYCLES = 4  # cycles at the end of a row that is simulated again, if its part is not given


@dataclasses.dataclass(frozen=True)
class RowMotion:
    """Signals of a row by name, at the times `t`, s.

    `values` are the row's parameters by name; `period` s is its model's nominal cycle; `gait` is its gait, or
    how it failed to come to one. `details` are the row's number and the values of its axes. `recorded` is the
    mean speed (m/s) of a cycle in the table, and the time (s) at which that cycle ends.
    """

    model: Model
    values: Mapping[str, float]
    t: Float[np.ndarray, " times"]
    signals: Mapping[str, Float[np.ndarray, " times"]]
    period: float
    gait: str
    details: tuple[str, ...]
    recorded: tuple[float, float] | None = None

    def title(self, clip: Clip, lift: float, heading: float) -> str:
        """Format the model, its gait and its mean speed.

        Args:
            clip: the part that is shown.
            lift: factor on the drawn height of feet.
            heading: that of the body, rad; the speed of one that moves backwards is negative.
        """
        speed = self._speed(float(clip.t[0]), float(clip.t[-1]), heading)
        moves = abs(speed) * self.period > _LEAST_DISTANCE * side_view.bounds(clip.skeleton, clip.camera)[1]
        motion = f"{self.gait} at {speed:.3g} m/s".strip() if moves else self.gait.strip()
        if lift != 1.0:
            motion += f" (lift drawn {lift:.3g} times as high)"
        return f"{self.model.name}, {motion}" if motion else self.model.name

    def _speed(self, first: float, last: float, heading: float) -> float:
        """The mean speed (m/s) of the part from `first` to `last`, s.

        That of the table where the part contains the end of its cycle, else that of whole strides.
        """
        if self.recorded is not None:
            speed, end = self.recorded
            if first < end <= last + self.period:
                return speed
        times = self._whole_strides(first, last)
        skeleton = self.model.skeleton(self.values, self.at(times))
        assert skeleton is not None  # as at the times of the clip
        first_place, last_place = middle(side_view.turned(skeleton, heading))
        ahead, aside = last_place - first_place
        return float(np.copysign(np.hypot(ahead, aside), ahead) / np.diff(times)[0])

    @cached_property
    def cycle(self) -> float:
        """The median stride (s) of the first foot that lands twice; of none, the nominal cycle."""
        strides = (np.diff(landed) for landed in self._landings())
        return next((float(np.median(times)) for times in strides if len(times)), self.period)

    def of_whole_cycles(self) -> RowMotion:
        """The last part of as many whole cycles as there are; unchanged if it is shorter than one."""
        t = self.t
        cycles = int((t[-1] - t[0]) / self.cycle * (1.0 + 1e-9))
        if not cycles:
            return self
        first = max(float(t[-1]) - cycles * self.cycle, float(t[0]))
        times = np.concatenate([[first], t[t > first]])
        return dataclasses.replace(self, t=times, signals=self.at(times))

    def _landings(self) -> Iterator[Float[np.ndarray, " touchdowns"]]:
        """The touchdowns (s) of each foot in turn."""
        for name in contact_signals(self.signals):
            yield _touchdowns(self.t, self.signals[name], SHORTEST_CONTACT * self.period)

    def _whole_strides(self, first: float, last: float) -> Float[np.ndarray, 2]:
        """The first and last touchdown (s) of a foot in a part, or two touchdowns of a stride near it.

        Without two touchdowns in the whole motion, the part itself.
        """
        for landed in self._landings():
            if len(landed) < 2:
                continue
            shown = landed[(first <= landed) & (landed <= last)]
            if len(shown) > 1:
                return shown[[0, -1]]
            before = int(np.clip(np.searchsorted(landed, 0.5 * (first + last)) - 1, 0, len(landed) - 2))
            return landed[before : before + 2]
        return np.array([first, last])

    def at(self, times: Float[np.ndarray, " frames"]) -> dict[str, Float[np.ndarray, " frames"]]:
        """The signals at times (s), interpolated linearly; angles and contacts from the nearest sample."""
        edges = 0.5 * (self.t[1:] + self.t[:-1])
        nearest = np.searchsorted(edges, times)
        stepwise = {quantity.name for quantity in self.model.signals if quantity.circular}
        stepwise.update(contact_signals(self.signals))
        at_times = {}
        for name, signal in self.signals.items():
            if name in stepwise:
                at_times[name] = signal[nearest]
            else:
                at_times[name] = np.interp(times, self.t, signal)
        return at_times

    def contact(self, limbs: int) -> Float[np.ndarray, "times limbs"]:
        """Ground contact of each limb, 1 on the ground.

        Raises:
            PlotError: the model has no such signal for a limb.
        """
        names = contact_signals(self.signals)[:limbs]
        if len(names) < limbs:
            raise PlotError(
                f"{self.model.name} has {limbs} limbs, but {len(names)} of the signals contact_1, contact_2, "
                "..., which show ground contact."
            )
        return np.array([self.signals[name] for name in names]).reshape(limbs, len(self.t)).T


def read_motion(
    directory: str | Path,
    row: int,
    start: float | None = None,
    seconds: float | None = None,
    *,
    renderer: str = "auto",
    trust: bool = False,
) -> RowMotion:
    """Read a row of a trace, or simulate a row of another run again as the explorer does.

    Args:
        directory: the result directory.
        row: the number of the row.
        start, seconds: the part of a row that is simulated again, s; by default its last cycles, or seconds.
        renderer: the one asked for.
        trust: as for `gaitsweep.models.find_of_table`.

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
        explorer = ", or gaitsweep explore" if kind == "continuation" else ""
        raise PlotError(
            f"{directory} contains {kind} rows, which have no motion: use a run of kind trace{explorer}."
        )
    part = _samples(table, directory, row)
    job = stored_job(table.attrs, trust=trust)
    design = job.design
    parameters, _ = design.values(row, row + 1)
    parameter_values = {name: float(value[0]) for name, value in parameters.items()}
    _check_drawable(design.model, parameter_values, renderer)
    names = [quantity.name for quantity in design.model.signals]
    recorded = None
    if kind == "trace":
        t, signals = _recorded(part, directory, names)
        # that of the row's end; tables of older versions have none
        gait = _gait_name(part.iloc[-1].get("gait")) if job.run.moved is None else ""
    else:
        t, signals, gait, recorded = _simulated(job, part, row, start, seconds)
    finite = np.isfinite(np.stack([t, *signals.values()])).all(axis=0)
    if np.count_nonzero(finite) < 2:
        status = str(part["status"].iloc[-1])
        raise PlotError(f"Row {row} of {directory} has no recorded motion: it ended with status {status}.")
    axes = [written(table, name, part[name].iloc[0]) for name in design.names if name in part.columns]
    motion = RowMotion(
        model=design.model,
        values=parameter_values,
        t=t[finite],
        signals={name: values[finite] for name, values in signals.items()},
        period=float(design.model.period(row_params(design, row))),
        gait=gait,
        details=(f"row {row}", *axes),
        recorded=recorded,
    )
    last_cycles = kind != "trace" and start is None and seconds is None
    return motion.of_whole_cycles() if last_cycles else motion


def _touchdowns(
    t: Float[np.ndarray, " times"], contact: Float[np.ndarray, " times"], shortest: float
) -> Float[np.ndarray, " touchdowns"]:
    """The touchdowns of a foot, s, without swings and stances shorter than `shortest` s."""
    starts, stops = contact_intervals(t, contact)
    starts, stops = joined_stances(starts, stops, starts[1:] - stops[:-1] >= shortest)
    return starts[(stops - starts >= shortest) & (starts > t[0])]


def _check_drawable(model: Model, values: Mapping[str, float], renderer: str) -> None:
    """Refuse a model that cannot be drawn, before its row is simulated."""
    if type(model).skeleton is Model.skeleton:
        raise PlotError(
            f"{model.name} has no `skeleton` to draw: define one. The section `See it move` of the page that "
            "`gaitsweep examples own_model` copies shows how."
        )
    if renderer == "mujoco" and model.mjcf(values) is None:
        raise PlotError(f"{model.name} has no MJCF, which MuJoCo needs: use --renderer matplotlib.")


def _recorded(
    part: pd.DataFrame, directory: Path, names: list[str]
) -> tuple[Float[np.ndarray, " times"], dict[str, Float[np.ndarray, " times"]]]:
    """Times (s) and signals of a row of a trace."""
    missing = [name for name in names if name not in part.columns]
    if missing:
        text = ", ".join(missing[:_NAMED]) + (", ..." if len(missing) > _NAMED else "")
        raise PlotError(
            f"The table of {directory} lacks the signals {text}: run its job again into another directory."
        )
    part = part.sort_values("t")
    return part["t"].to_numpy(float), {name: part[name].to_numpy(float) for name in names}


def _simulated(
    job: Job, part: pd.DataFrame, row: int, start: float | None, seconds: float | None
) -> tuple[
    Float[np.ndarray, " times"], dict[str, Float[np.ndarray, " times"]], str, tuple[float, float] | None
]:
    """Times (s) and signals of a row simulated again, its gait or failure, and its recorded speed.

    The speed is that of `RowMotion.recorded`. A row that failed at its start has no times.
    """
    times = part["t_end" if "t_end" in part.columns else "t"].to_numpy(float)
    end = float(times[np.isfinite(times)].max(initial=0.0))
    if end == 0.0:
        return np.zeros(0), {}, "", None
    context = prepare(job)
    replayer = replayer_of(context, np.array([row]))
    length = _LAST_CYCLES * float(replayer.periods[0]) if seconds is None else seconds
    first = max(0.0, end - length) if start is None else start
    if not 0.0 <= first < end:
        raise PlotError(f"{first:g} s is outside the row, which goes from 0 to {end:g} s.")
    last = end if seconds is None else min(end, first + seconds)
    (replayed,) = replayer.replayed(Windows(last - first, first))
    until = last * (1.0 + 1e-9)  # with rounding
    at = max(int(np.count_nonzero(times <= until)) - 1, 0)
    record = part.iloc[at]
    gait = record.get("gait")
    if "gait" not in part.columns and replayed.gait != -1:  # crossings of a return map
        gait = gaits(context.model, np.array([replayed.gait]))[0]
    status = str(record["status"])
    failure = "" if status in Status.SOUND else status.replace("_", " ")
    shown = replayed.t <= until
    signals = {name: values[shown] for name, values in replayed.signals.items()}
    speed = _recorded_speed(context.model, record)
    recorded = None if speed is None else (speed, float(times[at]))
    return replayed.t[shown], signals, _gait_name(gait) or failure, recorded


def _recorded_speed(model: Model, record: pd.Series) -> float | None:
    """The observable `speed` (m/s) of a record, the mean of a cycle; None if the model or record has none.

    An orbit of several cycles has none either: each has its own speed, and the table has that of one.
    """
    observed = ((quantity.name, quantity.unit) for quantity in model.observables)
    period: Any = record.get("attractor_period", 1)
    if period > 1 or ("speed", "m/s") not in observed:
        return None
    speed: Any = record.get("speed_end", record.get("speed_n", np.nan))
    return float(speed) if np.isfinite(speed) else None


def _gait_name(gait: Any) -> str:
    """The name of a gait in a table; empty if it is missing or none."""
    return "" if gait is None or pd.isna(gait) or gait == "none" else str(gait)


def _samples(table: pd.DataFrame, directory: Path, row: int) -> pd.DataFrame:
    """The records of a row, which must have run."""
    rows = int(table.attrs["manifest"]["rows"])
    if not 0 <= row < rows:
        allowed = f"rows 0 to {rows - 1}" if rows > 1 else "only row 0"
        raise PlotError(f"Row {row} does not exist: {directory} has {allowed}.")
    part = rows_where(table, table["row"] == row)
    if part.empty:
        raise PlotError(f"Row {row} of {directory} has not run yet: run the job again to continue it.")
    return part
