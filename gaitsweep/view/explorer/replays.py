"""Rows that are simulated again for animation, from their own starts or from points of the section."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Real

from gaitsweep.contract import Model, Quantity
from gaitsweep.dynamics.ground import is_uneven
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.engine.poincare.model_map import ModelMap
from gaitsweep.engine.recorders.recordings import WindowsRecorder
from gaitsweep.engine.sweep.sweep import sweep
from gaitsweep.engine.sweep.sweep_spec import SweepProgress, SweepSpec
from gaitsweep.row_outcome import RowOutcome
from gaitsweep.skeleton import Skeleton, contact_signals
from gaitsweep.view.movie.animation import Clip
from gaitsweep.view.movie.side_view import (
    bounds,
    heading,
    nearest_first,
    points_of,
    projected,
    turned,
    with_points,
)

SAMPLES_PER_CYCLE = 64  # of contacts, in a nominal cycle
PICTURES_EVERY = 2  # samples
_NO_PERIOD = 1.0  # s, where no row has a nominal period
_BLOCK_BYTES = 128 * 2**20  # of the signals of the rows of one block
_MAX_GROWTH = 4.0  # of the body's size since the first picture; a row in which it grows further diverges

PerRow = Real[np.ndarray, " rows"]  # a number for each row
PerPoint = Real[np.ndarray, " points"]  # a number for each point of the section
Samples = Float[np.ndarray, " samples"]  # a number for each sample
OnProgress = Callable[[SweepProgress], None]


@dataclasses.dataclass(frozen=True)
class Crossings:
    """The crossings of the section of one row: number (m,), time (m,) s, observables (m, k)."""

    number: Int[np.ndarray, " crossings"]
    t: Float[np.ndarray, " crossings"]
    observed: Float[np.ndarray, "crossings observables"]

    def where(self, mask: Bool[np.ndarray, " crossings"]) -> Crossings:
        """The crossings for which a mask (m,) is true."""
        return Crossings(self.number[mask], self.t[mask], self.observed[mask])

    def until(self, t: float) -> Crossings:
        """The crossings up to a time, s."""
        return self.where(self.t <= t * (1.0 + 1e-9))


@dataclasses.dataclass(frozen=True)
class Stretch:
    """A stretch of a row's motion from `begin` to `end`, s; if `loops`, one period of a steady gait."""

    name: str
    begin: float
    end: float
    loops: bool = False


@dataclasses.dataclass(frozen=True)
class Pictures:
    """The side view of the body at n equally spaced instants.

    `points` (n, c) m are the coordinates x, y of all points of limbs, bodies and springs relative to the
    camera; `camera` (n,) m is its position along the ground; `half`, `height`, `depth` m bound the body.
    """

    points: Float[np.ndarray, "pictures coordinates"]
    camera: Float[np.ndarray, " pictures"]
    half: float
    height: float
    depth: float


@dataclasses.dataclass(frozen=True)
class Motion:
    """One simulated stretch.

    `t` (m,) s are equally spaced instants, and `pictures` has every `stride`-th of them; `contact` (m, limbs)
    is 1 on the ground; `pictures` is None for a model without a skeleton.
    """

    stretch: Stretch
    t: Float[np.ndarray, " frames"]
    stride: int
    contact: Float[np.ndarray, "frames limbs"]
    pictures: Pictures | None


# A remark of the page, which draws a body on level ground.
_EVEN = "The ground is uneven, and drawn level."


@dataclasses.dataclass(frozen=True)
class BodyParts:
    """Points of each limb, body and spring of a model, in the order of `Pictures`."""

    limbs: tuple[int, ...]
    bodies: tuple[int, ...]
    springs: int
    names: tuple[str, ...]
    pairs: tuple[tuple[int, bool], ...]
    note: str

    @classmethod
    def of(cls, skeleton: Skeleton) -> BodyParts:
        """The parts of a skeleton."""
        return cls(
            limbs=tuple(limb.points.shape[1] for limb in skeleton.limbs),
            bodies=tuple(body.shape[1] for body in skeleton.bodies),
            springs=len(skeleton.springs),
            names=tuple(limb.name for limb in skeleton.limbs),
            pairs=tuple((limb.pair, limb.far) for limb in skeleton.limbs),
            note=skeleton.note,
        )


@dataclasses.dataclass(frozen=True)
class Windows:
    """The time windows in which rows are recorded, s.

    The first begins at `first`; `more` others begin at `second`, `second + spacing` and so on; each has the
    length `length`.
    """

    length: float
    first: float = 0.0
    second: float = 0.0
    spacing: float = 0.0
    more: int = 0


@dataclasses.dataclass(frozen=True)
class ReplayedRow:
    """One row simulated again: its crossings, samples of its signals (n,) at times `t` (n,) s, and its end.

    `gait` is the number of its gait at the end, -1 if unknown; `place` is its place among the simulated rows.
    """

    row: int
    place: int
    crossings: Crossings
    t: Samples
    signals: dict[str, Samples]
    gait: int


class Replayer:
    """Simulates rows again and draws stretches of their motion.

    Args:
        spec: the sweep of their job.
        rows: their numbers (n,).
        parameters, starts: their values (n,) by name.
        initial: values from which moving parameters begin, by name.
    """

    def __init__(
        self,
        spec: SweepSpec,
        rows: Int[np.ndarray, " rows"],
        parameters: Mapping[str, PerRow],
        starts: Mapping[str, PerRow],
        initial: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self._spec = spec
        self._rows = rows
        self._inputs = (parameters, starts)
        model = spec.model
        at_start = dict(parameters)
        at_start |= {name: np.full(rows.size, value) for name, value in initial.items()}
        self._parameters = [
            {name: float(values[place]) for name, values in at_start.items()} for place in range(rows.size)
        ]
        hosted = {name: jnp.asarray(values) for name, values in model.on_host(at_start).items()}
        periods = np.asarray(jax.vmap(lambda values: model.period(model.params(values)))(hosted))
        known = np.isfinite(periods) & (periods > 0.0)
        # a row without a nominal period, which has failed, has the shortest one of the others
        self.periods = np.where(known, periods, periods[known].min() if known.any() else _NO_PERIOD)
        self.every = float(self.periods.min()) / SAMPLES_PER_CYCLE
        self.parts: BodyParts | None = None
        self._contacts = contact_signals(q.name for q in model.signals)

    def replayed(self, windows: Windows, on_progress: OnProgress | None = None) -> Iterator[ReplayedRow]:
        """The rows one after the other, simulated in one batch."""
        rows, spec = self._rows, self._spec
        samples = int(np.ceil(windows.length / self.every)) + 1
        recorder = WindowsRecorder(
            spec.model, self.every, samples, windows.first, windows.second, windows.spacing, windows.more
        )
        cycles = recorder.duration / float(self.periods.min())
        room = int(_BLOCK_BYTES / (8 * recorder.width * (recorder.total + cycles)))
        block = min(max(room, 1), rows.size)
        # programs of XLA are compiled for the width of the run
        lanes = spec.lanes if spec.engine == "xla" else min(spec.lanes, max(8, block))
        batch = dataclasses.replace(
            spec, recorder=recorder, n_rows=rows.size, block=block, lanes=lanes, values=self._values
        )
        for number in range(-(-rows.size // block)):
            outcomes: dict[int, RowOutcome] = {}
            sweep(batch, [number], outcomes.__setitem__, on_progress)
            yield from self._of_block(outcomes[number], recorder)

    def _values(self, first: int, last: int) -> tuple[dict[str, PerRow], dict[str, PerRow]]:
        """The parameters and starts of rows `first` to `last` - 1, by name."""
        parameters, starts = (
            {name: values[first:last] for name, values in inputs.items()} for inputs in self._inputs
        )
        return parameters, starts

    def _of_block(self, result: RowOutcome, recorder: WindowsRecorder) -> Iterator[ReplayedRow]:
        """The rows of a simulated block."""
        observed = len(self._spec.model.observables)
        cuts = np.cumsum(result.record_counts)[:-1]
        end = 2 + observed  # of the columns of a crossing: its number, its time, the observables
        for i, records in enumerate(np.split(result.samples, cuts)):
            is_crossing = records[:, 0] >= 0.0
            crossings, samples = records[is_crossing], records[~is_crossing]
            yield ReplayedRow(
                row=int(self._rows[result.row[i]]),
                place=int(result.row[i]),
                crossings=Crossings(crossings[:, 0].astype(np.int64), crossings[:, 1], crossings[:, 2:end]),
                t=samples[:, 1],
                signals=dict(zip(recorder.names[end:], samples[:, end:].T, strict=True)),
                gait=int(result.labels["gait"][i]),
            )

    def motion(self, replayed: ReplayedRow, stretch: Stretch) -> Motion | None:
        """A stretch of a row inside one window, up to its last finite numbers.

        None if fewer than two frames are left.
        """
        place = replayed.place
        stride = PICTURES_EVERY * max(1, round(self.periods[place] / self.periods.min()))
        slack = 1e-6 * self.every
        first, last = np.searchsorted(replayed.t, [stretch.begin - slack, stretch.end + slack])
        signals = {name: values[first:last] for name, values in replayed.signals.items()}
        t = replayed.t[first:last]
        length = self._length(t, signals)
        if length < 2 * stride + 1:
            return None
        of_pictures = {name: values[:length:stride] for name, values in signals.items()}
        pictures = self._pictures(place, of_pictures, t[:length:stride])
        if pictures is not None and len(pictures.points) * stride < length:  # a body that falls apart
            length = (len(pictures.points) - 1) * stride + 1
            if length < 2 * stride + 1:
                return None
        complete = t[0] - stretch.begin <= self.every and stretch.end - t[length - 1] <= stride * self.every
        stretch = dataclasses.replace(stretch, loops=stretch.loops and complete)
        contact = [signals[name][:length] for name in self._contacts]
        of_limbs = np.stack(contact, axis=1) if contact else np.zeros((length, 0))
        return Motion(stretch, t[:length], stride, of_limbs, pictures)

    def _length(self, t: Samples, signals: Mapping[str, Samples]) -> int:
        """The number of samples before the first that is not finite, or is in the next window."""
        finite = np.isfinite(np.stack([t, *signals.values()])).all(axis=0)
        length = len(t) if finite.all() else int(np.argmin(finite))
        gaps = np.flatnonzero(np.diff(t[:length]) > 1.5 * self.every)
        return int(gaps[0]) + 1 if gaps.size else length

    def _pictures(self, place: int, signals: dict[str, Samples], t: Samples) -> Pictures | None:
        """The pictures of a row's signals (n,) at times `t` (n,) s; None without a skeleton."""
        skeleton = self._spec.model.skeleton(self._parameters[place], signals)
        if skeleton is None or not points_of(skeleton).size:
            return None
        if is_uneven(self._spec.model):
            skeleton = dataclasses.replace(skeleton, note=_EVEN)
        if self.parts is None:
            self.parts = BodyParts.of(skeleton)
        return pictures_of(skeleton, t, float(self.periods[place]))


def pictures_of(skeleton: Skeleton, t: Samples, period: float) -> Pictures:
    """The side view of a body, until it falls apart.

    Args:
        skeleton: the body.
        t: the times of its samples, s, (n,).
        period: duration of a cycle, s.
    """
    skeleton = turned(skeleton, heading(skeleton))
    camera = Clip(t, skeleton, t, np.zeros((len(t), 0)), period, "").camera
    middle = np.column_stack([camera, np.zeros(len(t))])[:, None, :]
    parts = [limb.points - middle for limb in skeleton.limbs]
    parts += [nearest_first(body - middle) for body in skeleton.bodies]
    parts += [spring - middle for spring in skeleton.springs]
    points = projected(np.concatenate(parts, axis=1)).reshape(len(t), -1)
    size = np.abs(points).max(axis=1)
    diverged = ~np.isfinite(size) | (size > _MAX_GROWTH * size[0])
    if diverged.any():  # a row that falls or diverges
        cut = int(np.argmax(diverged))
        skeleton = with_points(skeleton, lambda part: part[:cut])
        points, camera = points[:cut], camera[:cut]
    return Pictures(points, camera[:, 0], *bounds(skeleton, camera))


def states_at(
    mapping: ModelMap, points: Sequence[Points], values: Mapping[str, PerPoint]
) -> tuple[Model, dict[str, PerPoint], dict[str, PerPoint]]:
    """Use points of the section as starts of trajectories.

    Args:
        mapping: a map of the model's states.
        points: n points.
        values: parameters (n,) by name.

    Returns:
        A model that can begin in any of its states, and its parameters and starts (n,) by name.
    """
    n = len(points)
    joined = jax.tree.map(lambda *leaves: np.concatenate(leaves), *points)
    complete = mapping.complete(values, n)

    def placed(values: Any, at: jax.Array, modes: Any) -> tuple[Any, Any]:
        return mapping.chart.from_coordinates(mapping.params(values), at, modes), mapping.resolved(values)

    states, parameters = jax.jit(jax.vmap(placed))(complete, joined.at, joined.modes)
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(states)]
    columns = np.concatenate([leaf.reshape(n, -1).astype(np.float64) for leaf in leaves], axis=1)
    model = _in_state(mapping.model, jax.tree.map(lambda leaf: leaf[0], states))
    names = [quantity.name for quantity in model.initial_conditions]
    starts = dict(zip(names, columns.T, strict=True))
    return model, {name: np.asarray(v) for name, v in parameters.items()}, starts


def _in_state(model: Model, state: Any) -> Model:
    """The model with all numbers of a state as initial conditions; `state` is one of its states."""
    leaves, tree = jax.tree.flatten(state)
    shapes = [(np.shape(leaf), np.asarray(leaf).dtype) for leaf in leaves]
    cuts = np.cumsum([int(np.prod(shape)) for shape, _ in shapes])
    quantities = tuple(Quantity(f"state_{i}", "1", "number of a state") for i in range(int(cuts[-1])))

    def init(self: Model, params: Any, start: Mapping[str, jax.Array]) -> Any:
        numbers = jnp.stack([jnp.asarray(start[quantity.name]) for quantity in quantities])
        parts = jnp.split(numbers, cuts[:-1].tolist())
        shaped = [
            part.reshape(shape).astype(dtype) for part, (shape, dtype) in zip(parts, shapes, strict=True)
        ]
        return jax.tree.unflatten(tree, shaped)

    members = {"init": init, "initial_conditions": property(lambda self: quantities)}
    of_any_state = type(f"{type(model).__name__}InState", (type(model),), members)
    fields = dataclasses.fields(model)  # pyright: ignore[reportArgumentType] (each is a dataclass)
    return of_any_state(**{field.name: getattr(model, field.name) for field in fields if field.init})
