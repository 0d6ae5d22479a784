"""The sampled rows of a self-check, the changes of their observables, and its result for the manifest."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from gaitsweep.contract import Model, Quantity
from gaitsweep.design import Design
from gaitsweep.engine.poincare.maps import wrap_difference
from gaitsweep.engine.recorders.bounds import MIN_SCALE
from gaitsweep.engine.solver.methods import fixed_step_scheme
from gaitsweep.errors import EXIT_STRICT, UserError
from gaitsweep.runs.prepare import RunContext, nominal_period
from gaitsweep.table.manifest import DIFFERENCES

# The least size of an observable, as a share of its magnitude.
LEAST_SIZE = 1e-2


def circular(model: Model) -> Bool[np.ndarray, " observables"]:
    """Mask of the observables that are angles, (observables,)."""
    return np.array([quantity.circular for quantity in model.observables])


def changes(
    model: Model, once: Float[np.ndarray, "*rows observables"], again: Float[np.ndarray, "*rows observables"]
) -> Float[np.ndarray, "*rows observables"]:
    """Return the distance of observables (..., observables), that of angles by the shorter way."""
    return np.abs(wrap_difference(once - again, circular(model)))


def sizes(
    quantities: tuple[Quantity, ...], values: Float[np.ndarray, "*rows quantities"]
) -> Float[np.ndarray, " quantities"]:
    """Return the sizes (k,) by which quantities are compared, from their values (..., k).

    They are 1 rad for angles, `Quantity.scale`, or the range of the known values, at least `LEAST_SIZE` of
    the largest magnitude, and `MIN_SCALE`, also of a quantity without known values.
    """
    known = np.where(np.isfinite(values), values, np.nan).reshape(-1, len(quantities))
    size = np.full(len(quantities), MIN_SCALE)
    for i, quantity in enumerate(quantities):
        column = known[:, i][~np.isnan(known[:, i])]
        if quantity.circular or quantity.scale is not None:
            size[i] = 1.0 if quantity.scale is None or quantity.circular else quantity.scale
        elif column.size:
            size[i] = max(np.ptp(column), LEAST_SIZE * np.abs(column).max(), MIN_SCALE)
    return size


def counted(model: Model, *values: Float[np.ndarray, "... observables"]) -> Bool[np.ndarray, " observables"]:
    """Mask of the observables (k,) that are counts: whole numbers in all known values (..., k)."""
    whole = ~circular(model)
    for observed in values:
        known = np.where(np.isfinite(observed), observed, 0.0).reshape(-1, whole.size)
        whole &= np.all(known == np.round(known), axis=0)
    return whole


class SelfCheckError(UserError):
    """A self-check found a difference, and the run is strict."""

    exit_code = EXIT_STRICT


@dataclasses.dataclass
class SelfCheck:
    """Result of a self-check; a row that is sensitive counts nowhere else.

    Args:
        rows: the number of rows rerun, including the added ones.
        of: the number of rows of the job.
        finer: the finer steps or tolerances, in words.
        stored_differs: rows that do not reproduce their stored records with the same steps.
        status_differs: rows that end with another status with finer steps.
        gait_differs: rows with another gait.
        count_differs: rows with another number of crossings, or of another whole-numbered observable.
        sensitive: rows on a boundary, or whose moved starts change as much.
        moved: rows of which an observable or the time of a crossing changes by more than is allowed.
        unstable: rows that rest on an unstable gait.
        unstable_first: the first of them: its number, and the moving parameter or the axes there.
        by_step: rows of a model with a step of its own, of which an observable changes much with a finer one.
        largest: the largest change of each observable: of settled rows at their end, of others over their
            first crossings.
        worst: name and unit of the observable with the largest change relative to its size.
        repeating: the rows that errors of the integration keep from settling (`repeating_rows`).
        added: rows with comparable ends that were rerun besides the sample, which had none.
    """

    rows: int
    of: int
    finer: str
    stored_differs: int = 0
    status_differs: int = 0
    gait_differs: int = 0
    count_differs: int = 0
    sensitive: int = 0
    moved: int = 0
    unstable: int = 0
    unstable_first: dict[str, float] = dataclasses.field(default_factory=dict)
    by_step: int = 0
    largest: dict[str, float] = dataclasses.field(default_factory=dict)
    worst: dict[str, str] = dataclasses.field(default_factory=dict)
    repeating: dict[str, Any] = dataclasses.field(default_factory=dict)
    added: int = 0
    _worst_share: float = -1.0
    _sensitive_rows: set[int] = dataclasses.field(default_factory=set)
    _wrong_rows: set[int] = dataclasses.field(default_factory=set)

    def record_rows(self, sensitive: Int[np.ndarray, " n"], wrong: Int[np.ndarray, " k"]) -> None:
        """Count sensitive rows once, also if their ends and their crossings differ, and no wrong ones."""
        self._sensitive_rows.update(sensitive.tolist())
        self._wrong_rows.update(wrong.tolist())
        self.sensitive = len(self._sensitive_rows - self._wrong_rows)

    def record_changes(
        self,
        quantities: tuple[Quantity, ...],
        change: Float[np.ndarray, "rows quantities"],
        size: Float[np.ndarray, " ..."],
    ) -> None:
        """Update the largest changes from changes (n, quantities), where known; `size` broadcasts to them."""
        size = np.broadcast_to(size, change.shape)
        # an unchanged value has the share 0 even if its size is 0, as the interval of crossings at one
        # instant
        share = np.divide(change, size, out=np.where(change > 0.0, np.inf, 0.0), where=size > 0.0)
        share[np.isnan(size)] = 0.0
        for i, quantity in enumerate(quantities):
            column = change[:, i]
            known = np.isfinite(column)
            if known.any():
                most = float(column[known].max())
                self.largest[quantity.name] = max(most, self.largest.get(quantity.name, 0.0))
                if (largest := float(share[known, i].max())) > self._worst_share:
                    self._worst_share = largest
                    self.worst = {"name": quantity.name, "unit": quantity.unit}

    def judged(self) -> dict[str, Any]:
        """Return the fields for the manifest, with the verdict."""
        fields = dataclasses.asdict(self)
        fields = {name: value for name, value in fields.items() if not name.startswith("_")}
        return fields | {"verdict": "warned" if any(map(fields.get, DIFFERENCES)) else "passed"}


# The sample's steps, as a share of the run's own: irrational, so that no step ends where one of these does.
FINER = 1.0 / math.sqrt(7.0)
# The largest share of a run's work that its sample takes, and its fewest rows, if a job gives no number.
MOST_WORK = 0.1
LEAST_ROWS = 4
# Crossings compared of rows that do not settle, and of run kinds that do not settle rows.
CROSSINGS = 10


def finer_share(context: RunContext) -> float:
    """Return the steps of the sample as a share of the run's own: half of those along a path of noise."""
    steps = fixed_step_scheme(context.spec.numerics.method, context.model)
    return 0.5 if steps is not None and steps.stochastic else FINER


def is_checked(context: RunContext) -> bool:
    """Return whether a run integrates something that finer steps would change."""
    steps = fixed_step_scheme(context.spec.numerics.method, context.model)
    exact = steps is not None and steps.is_return_map
    return context.job.run.integrates and not exact


def rows_to_repeat(context: RunContext) -> int:
    """Return the number of rows of the sample: as the job says, else at most 32.

    Without a number in the job they take about `MOST_WORK` of the run's work at most, or are `LEAST_ROWS`.
    """
    job, design = context.job, context.design
    if "verify" in job.model_fields_set or design.n_rows <= LEAST_ROWS:
        return min(job.verify, design.n_rows)
    if math.isnan(period := nominal_period(design)):
        return min(job.verify, LEAST_ROWS)
    cycles = job.run.cost(design, 1.0, period).likely  # of a row, as a number of cycles
    if job.run.compared in ("settled", "ends"):
        repeated = (1.0 + 1.0 / FINER) * cycles
    else:
        repeated = (2.0 + 1.0 / FINER) * min(cycles, CROSSINGS)
    most = int(MOST_WORK * design.n_rows * cycles / max(repeated, 1e-300))
    return min(job.verify, design.n_rows, max(LEAST_ROWS, most))


def most_added(context: RunContext, rows: int) -> int:
    """Return the most rows that are added to a sample of `rows` of which none has a comparable end."""
    compares_ends = context.job.run.compared != "crossings"
    return min(LEAST_ROWS, rows, context.design.n_rows - rows) if compares_ends else 0


def sample_rows(design: Design, count: int) -> Int[np.ndarray, " sampled"]:
    """Select representative rows (n,): both ends of axes, as far as `count` allows, and evenly spread points.

    Args:
        design: the job's rows.
        count: how many at most; all rows where there are no more.
    """
    if design.n_rows <= count:
        return np.arange(design.n_rows, dtype=np.int64)
    lengths = np.array([group.length for group in design.groups], dtype=np.int64)
    strides = np.array([design.stride(place) for place in range(lengths.size)], dtype=np.int64)
    # the additive recurrence of Roberts (2018): powers of the root of x^(d+1) = x + 1
    root = 1.5
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (lengths.size + 1))
    slopes = root ** -np.arange(1.0, lengths.size + 1.0)
    ends = [(axis, end) for axis in range(lengths.size) for end in (0, lengths[axis] - 1)]
    chosen: dict[int, None] = {}
    for k in range(64 * count):
        point = np.floor(np.mod(0.5 + k * slopes, 1.0) * lengths).astype(np.int64)
        if k < len(ends):
            axis, end = ends[k]
            point[axis] = end
        chosen.setdefault(int(np.sum(np.minimum(point, lengths - 1) * strides)))
        if len(chosen) == count:
            break
    return np.array(sorted(chosen), dtype=np.int64)
