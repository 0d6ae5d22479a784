"""Remarks on the rows of a job with a user's model, from its functions at some of the rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Int

from gaitsweep.contract import Quantity
from gaitsweep.design.design import Design
from gaitsweep.dynamics.mjcf import OfMjcf
from gaitsweep.errors import JobError
from gaitsweep.expression import ExpressionError
from gaitsweep.job.reading import default_setting
from gaitsweep.models.conformity import remark_on_rates, variables_without_rate
from gaitsweep.models.sampled_points import MAX_NAMED
from gaitsweep.models.starts import idle_starts, sets_starts, starts_in_ground
from gaitsweep.models.value_faults import faults_of_rows

# Rows at which a model's functions are evaluated before a job runs, and axes whose corners are among them.
_TRIED_ROWS = 64
_AXES_WITH_CORNERS = 5


def remarks_on_rows(design: Design, name: str) -> list[str]:
    """Return sentences about starts without effect on a user's model, and about faults at some rows.

    Rows are the corners of the axes and others, or all rows of a small job. Of models of gaitsweep only
    starts of a body in the ground are reported; models with `host_parameters` are not checked. If a formula
    has no value in one of the rows, no fault is reported: the run reports the formula for the row's block.

    Args:
        design: the job's rows.
        name: the name of the model in the job.
    """
    model = design.model
    if model.host_parameters:
        return []
    rows = _some_rows(design)
    of_user = not type(model.original).__module__.startswith("gaitsweep.")
    remarks = _remarks_on_functions(design, name) if of_user else []
    try:
        if isinstance(model.original, OfMjcf):
            once = np.unique(rows)
            in_ground = starts_in_ground(model, *design.values_in(once), _words_of_rows(design, once))
            remarks = [*(f"{text[0].upper()}{text[1:]}" for text in in_ground), *remarks]
        if of_user:
            faults = faults_of_rows(model, *design.values_in(rows), _words_of_rows(design, rows))
            remarks += [f"The model is {name}, {words}" for words in faults]
    except (ExpressionError, JobError):
        pass  # the run reports these, where it comes to their rows
    return remarks


def _remarks_on_functions(design: Design, name: str) -> list[str]:
    """Return sentences about starts without effect, and about variables without a rate."""
    model = design.model
    remarks = [
        f"{start} has no effect: {sets_starts(model.original)} of {name} sets it."
        for start in _idle_starts(design)
    ]
    if without_rate := variables_without_rate(model):
        remarks.append(f"The model is {name}, but its function {remark_on_rates(without_rate)}")
    return remarks


def _words_of_rows(design: Design, rows: Int[np.ndarray, " rows"]) -> Callable[[int], str]:
    """Return the function from the place of a row to words such as " at the start of row 3 (x = 1)"."""
    varied = design.at(rows, design.names[:MAX_NAMED])

    def in_words(place: int) -> str:
        """Describe the row at a place."""
        words = f" at the start of row {rows[place]}"
        if not varied:
            return words
        point = ", ".join(f"{name} = {column[place]:.6g}" for name, column in varied.items())
        more = ", ..." if len(design.names) > MAX_NAMED else ""
        return f"{words} ({point}{more})"

    return in_words


def _idle_starts(design: Design) -> list[str]:
    """Return the starts without effect that a job varies, or sets to another value than their default."""
    idle = idle_starts(design.model.original)
    quantities = design.model.initial_conditions
    used = design.closure(quantity.name for quantity in quantities if quantity.name not in idle)
    return [
        quantity.name
        for quantity in quantities
        if quantity.name in {*idle} - used
        and (quantity.name in design.names or _is_set(quantity, design.settings[quantity.name]))
    ]


def _is_set(quantity: Quantity, setting: float | str) -> bool:
    """Return whether a start has another setting than its default; a start without a default has."""
    return quantity.default is None or setting != default_setting(quantity.default)


def _some_rows(design: Design) -> Int[np.ndarray, " rows"]:
    """Return `_TRIED_ROWS` rows: corners of the first axes, random ones and the last; few repeat."""
    if design.n_rows <= _TRIED_ROWS:
        return np.arange(_TRIED_ROWS) % design.n_rows  # as many, so that the same program evaluates them
    axes = [position for position, group in enumerate(design.groups) if group.length > 1]
    corners = np.zeros(1, np.int64)
    for position in axes[:_AXES_WITH_CORNERS]:
        to_last_point = (design.groups[position].length - 1) * design.stride(position)
        corners = np.concatenate([corners, corners + to_last_point])
    others = np.random.default_rng(0).integers(0, design.n_rows, _TRIED_ROWS - corners.size - 1)
    return np.concatenate([corners, others, [design.n_rows - 1]])
