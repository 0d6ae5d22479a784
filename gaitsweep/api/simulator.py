"""A job as a simulator for inference: a function from constants to observables, as for the package sbi."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float, Shaped
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.analysis.records import names_in, require_numbers
from gaitsweep.api.run import run_in_memory
from gaitsweep.column_meanings import COLUMNS
from gaitsweep.contract import names_gait
from gaitsweep.engine.content import held_contents
from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job, load_job
from gaitsweep.kinds.run_kind import table_columns
from gaitsweep.status import Status

# A crossing of an orbit of several, such as `rate_end_2`, whose column only a table with such an orbit has.
_OF_ORBIT = re.compile(r"(?<=_end)_[0-9]+$")


class Simulated(NamedTuple):
    """The columns (n, m) of the rows of n sets of values, NaN without a sound end, and the statuses (n,)."""

    observed: Float[np.ndarray, "sets columns"]
    statuses: Shaped[np.ndarray, " sets"]


@final
class Simulator:
    """A function from values of some parameters to columns of a job's table; see `simulator`."""

    def __init__(self, job: Job, parameters: Sequence[str], columns: Sequence[str]) -> None:
        self._fields = {**job.resolved(), "figures": []}  # which may need the job's own axes
        # `auto` remains open: the sets of a call may be stiff where the job's own values are not
        self._fields["numerics"]["method"] = job.numerics.method
        self._folder = job.folder
        self.parameters, self.columns = list(parameters), list(columns)

    def __call__(self, values: Any) -> Any:
        """Simulate one row for each set of values.

        Args:
            values: an array or a torch tensor (n, k), or (k,) for one set, of the k parameters.

        Returns:
            The columns (n, m), NaN in rows without a sound end; (m,) for one set. A tensor for a tensor.

        Raises:
            ArgumentError: the values have another shape.
            JobError: a value is outside the bounds of its parameter.
        """
        observed = self.run(values).observed
        single = np.ndim(values) == 1
        result = observed[0] if single else observed
        return values.new_tensor(result) if hasattr(values, "new_tensor") else result

    def run(self, values: ArrayLike) -> Simulated:
        """Simulate one row for each set of values (n, k)."""
        sets = np.atleast_2d(np.asarray(values, np.float64))
        if sets.ndim != 2 or sets.shape[1] != len(self.parameters):
            raise ArgumentError(
                f"the values have the shape {np.shape(values)}, but {len(self.parameters)} parameters "
                f"({', '.join(self.parameters)}) need (n, {len(self.parameters)})."
            )
        if not len(sets):
            return Simulated(np.empty((0, len(self.columns))), np.empty(0, object))
        fields = dict(self._fields)
        for section in ("params", "start"):
            fields[section] = {k: v for k, v in fields[section].items() if k not in self.parameters}
        axes = {name: sets[:, place].tolist() for place, name in enumerate(self.parameters)}
        fields |= {"vary": {"zip": axes}, "verify": 0}
        job = Job.model_validate(fields, context={"folder": self._folder})
        table = run_in_memory(job).table.sort_values("row")
        columns = table.reindex(columns=self.columns)
        require_numbers(columns, *self.columns)
        statuses = table["status"].astype(str).to_numpy()
        observed = columns.to_numpy(np.float64, copy=True)
        # a failed or undecided row has columns too, of the state in which it ended
        observed[~Status.SOUND.among(statuses)] = np.nan
        return Simulated(observed, statuses)


@held_contents()
def simulator(
    job: Job | str | Path | Mapping[str, Any], parameters: str | Sequence[str], columns: str | Sequence[str]
) -> Simulator:
    """Make a job a function from values of some parameters to observables, for inference.

    It is what the package sbi calls a simulator: `simulate_for_sbi(gs.simulator(...), proposal, n)`; sbi
    itself is not needed. Rows that fall, diverge or stay undecided are NaN, which sbi leaves out or learns,
    and `run` also returns their statuses.

    Args:
        job: a job, its file or its fields, with one record for each row (`settle`, `fixed_time`, `perturb`)
            and nothing under `vary`.
        parameters: the k parameters or start values that are inferred; the job's other constants stay. A
            model with noise needs its seed among them, or each row has the same noise.
        columns: the m columns of its table that are compared with measurements, such as `rate_end`.

    Raises:
        ArgumentError: the job varies something, its run has several records for a row, an expression under
            `run`, `numerics` or `figures` follows a parameter, a parameter is unknown, a column is unknown or
            holds texts, or one of them is named twice or none is named.
        JobError: an error in the job.

    Example:
        >>> import gaitsweep as gs
        >>> job = {
        ...     "name": "hops",
        ...     "model": "gaitsweep.examples.hopper:Hopper",
        ...     "start": {"launch_0": 2.5},
        ...     "run": {"kind": "settle"},
        ... }
        >>> hops = gs.simulator(job, ["omega", "restitution"], ["launch_end"])
        >>> hops([[12.0, 0.7], [12.5, 0.7]]).round(2).tolist()
        [[5.14], [4.93]]
    """
    if isinstance(job, str | Path):
        job = load_job(job)
    elif isinstance(job, Mapping):
        job = Job.model_validate(dict(job))
    if job.design.groups:
        varied = ", ".join(name for group in job.design.groups for name in group.axes)
        raise ArgumentError(f"the job varies {varied}: a simulator's rows differ in its parameters alone.")
    if not job.run.one_a_row:
        raise ArgumentError(f"a run of kind {job.run.kind_name} has several records for a row: use another.")
    known = [q.name for q in (*job.design.model.parameters, *job.design.model.initial_conditions)]
    parameters = names_in(parameters)
    for name in parameters:
        if name not in known:
            near = near_miss.suggestion(name, known)
            raise ArgumentError(f"{name} is not a parameter or start value of {job.design.model.name}{near}")
        # a call would keep the number of the job's own value, in silence
        if expressions := job.expressions_of(name):
            raise ArgumentError(
                f'{name} is a parameter of the simulator, but the job has the expression "{expressions[0]}" '
                "under run, numerics or figures, which has one value for all rows: write a number there."
            )
    columns = names_in(columns)
    for noun, names in (("parameter", parameters), ("column", columns)):
        if not names:
            raise ArgumentError(f"no {noun} is named: a simulator needs one or more.")
        if repeated := next((name for name in names if names.count(name) > 1), None):
            raise ArgumentError(f"{repeated} is named twice among the {noun}s.")
    of_table = [*parameters, *table_columns(job.design, job.run)]
    for name in columns:
        if _OF_ORBIT.sub("", name) not in of_table:
            raise ArgumentError(
                f"{name} is not a column of the job's table{near_miss.suggestion(name, of_table)}"
            )
        if names_gait(name) or (name in COLUMNS and not COLUMNS[name][0]):
            raise ArgumentError(f"The values of {name} are not numbers: name another column.")
    return Simulator(job, parameters, columns)
