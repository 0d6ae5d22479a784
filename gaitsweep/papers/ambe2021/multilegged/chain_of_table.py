"""The chain of a table: its parameters, its relative phases, and its distance from the theory's solutions."""

from __future__ import annotations

import graphlib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analyses import AnalysisError, axes_of
from gaitsweep.contract import Quantity
from gaitsweep.expression import ExpressionError, evaluate, names_used
from gaitsweep.papers.ambe2021.multilegged.parameters import PARAMETERS, SPRINGS, profile_parameters
from gaitsweep.papers.ambe2021.theory.chain import Chain
from gaitsweep.papers.ambe2021.theory.gaits import NONE_BEYOND
from gaitsweep.status import Status


def chain_of(table: pd.DataFrame, part: pd.DataFrame | None = None) -> Chain:
    """The chain of a table: its first row's columns, else its job's parameters, else Table 1's.

    Its fields are floats, and arrays where it has a profile.

    Args:
        table: its job, in `attrs`, gives the parameters that do not vary.
        part: the part of the table whose first row counts; by default all of it.

    Raises:
        AnalysisError: the job's parameters cannot be read, or are those of another model.
    """
    part = table if part is None else part
    fields = [np.asarray(field, float)[0] for field in chains_of(table, part.head(1))]
    return Chain(*(field if field.ndim else float(field) for field in fields))  # an array with a profile


def chains_of(table: pd.DataFrame, sets: pd.DataFrame) -> Chain:
    """The chains of n sets of parameters, fields (n,) each.

    With a profile m and a are (n, N-1), and kappa is (n, N-2).

    Args:
        table: its job, in `attrs`, gives the parameters that do not vary.
        sets: the columns that vary, one row for each set.

    Raises:
        AnalysisError: as for `chain_of`.
    """
    values = parameters_of(table, sets)
    shape = (max(len(sets), 1),)
    fields = {name: np.broadcast_to(values[name], shape) for name in Chain._fields}
    if (N := _springs_with_profile(table)) is not None:
        for name, last in (("m", N), ("kappa", N - 1), ("a", N)):
            inner = [np.broadcast_to(values[f"{name}_{i}"], shape) for i in range(2, last + 1)]
            fields[name] = np.stack(inner, axis=1)
    return Chain(**fields)


def parameters_of(table: pd.DataFrame, sets: pd.DataFrame) -> dict[str, Any]:
    """The chain's parameters without dampers, numbers or (n,); arguments and errors as for `chains_of`."""
    if not may_be_of_chain(table):
        raise AnalysisError("The table is not of the multi-legged chain: it lacks the chain's parameters.")
    # the theory has no dampers, and the root in their formulas has no value where an axis ends below zero
    defaults = {
        quantity.name: quantity.default
        for quantity in (*PARAMETERS, *profile_of(table).values())
        if quantity.name not in ("sigma", "D")
    }
    settings: dict[str, Any] = defaults | _job(table, "params")
    settings |= {str(name): sets[name].to_numpy(float) for name in sets if len(sets) and name in defaults}
    if (N := _springs_with_profile(table)) is not None:
        settings["N"] = N
    return _evaluated(settings, defaults)


def may_be_of_chain(table: pd.DataFrame) -> bool:
    """Whether a table's model is the chain, has all parameters of its theory, or is unknown."""
    model = (table.attrs.get("job") or {}).get("model")
    known = {*_job(table, "params"), *table.columns, *table.attrs.get("quantities", {})}
    return model in (None, "multilegged", "multilegged_reduced") or known >= set(Chain._fields)


def constants_of(
    table: pd.DataFrame, names: Sequence[str], part: pd.DataFrame | None = None
) -> dict[str, float]:
    """Some of the chain's parameters without dampers, which have one value in all rows, by name.

    Args:
        table: a table of the chain; its job gives the parameters that do not vary.
        names: the names of the parameters.
        part: the part of the table whose rows have one value; by default all of it.

    Raises:
        AnalysisError: one differs between rows, or as for `chain_of`.
    """
    part = table if part is None else part
    for name in names:
        if name in part and len(np.unique(part[name].to_numpy(float))) > 1:
            raise AnalysisError(f"{name} differs between the rows of the table: take rows with one value.")
    values = parameters_of(table, part.head(1))
    return {name: float(np.ravel(values[name])[0]) for name in names}


def _evaluated(settings: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """The settings with the formulas among `names` evaluated; they may use each other in any order.

    Raises:
        AnalysisError: formulas depend on each other in a cycle, or one has no value.
    """
    formulas = {name: settings[name] for name in names if isinstance(settings[name], str)}
    values = {name: value for name, value in settings.items() if not isinstance(value, str)}
    uses = {name: names_used(text) & set(formulas) for name, text in formulas.items()}
    try:
        order = list(graphlib.TopologicalSorter(uses).static_order())
    except graphlib.CycleError as error:
        raise AnalysisError("The job's formulas depend on each other in a cycle.") from error
    for name in order:
        try:
            values[name] = evaluate(formulas[name], values)
        except ExpressionError as error:
            raise AnalysisError(f"The job's {name} has no value: {error}") from error
    return values


def profile_of(table: pd.DataFrame) -> dict[str, Quantity]:
    """The parameters of the table's profile, by name; none without one."""
    N = _springs_with_profile(table)
    return {} if N is None else {quantity.name: quantity for quantity in profile_parameters(N)}


def _springs_with_profile(table: pd.DataFrame) -> int | None:
    """N of a chain with a profile; None without one."""
    structure = _job(table, "structure")
    return int(structure.get("N", SPRINGS)) if structure.get("profile") else None


def _job(table: pd.DataFrame, section: str) -> dict[str, Any]:
    """A section of the table's job, by name; empty without one."""
    job = table.attrs.get("job")
    return dict(job.get(section) or {}) if isinstance(job, Mapping) else {}


def springs_of(table: pd.DataFrame) -> int:
    """N of a table of the chain: of a trace from phase_1, ..., of others from psi_1_end or psi_1_n, ...

    Raises:
        AnalysisError: the table has neither.
    """
    legs = sum(bool(re.fullmatch(r"phase_\d+", str(name))) for name in table)
    springs = legs - 1 if legs else len(psi_columns(table, "_(end|n)"))
    if not legs and not springs:
        raise AnalysisError("The table is not of the multi-legged chain: it has no phase_1 and no psi_1_end.")
    return springs


def psi_columns(table: pd.DataFrame, suffix: str) -> list[str]:
    """The columns of the relative phases whose names end with a suffix, a regular expression."""
    return [str(name) for name in table if re.fullmatch(rf"psi_\d+{suffix}", str(name))]


def set_columns(table: pd.DataFrame) -> list[str]:
    """The swept axes of a table, except the phases of the start."""
    return without_phases(axes_of(table))


def without_phases(axes: Iterable[str]) -> list[str]:
    """The names of swept axes, except those of the phases of the start."""
    return [name for name in axes if not name.startswith(("psi_", "phi_"))]


def of_legs(trace: pd.DataFrame, signal: str) -> Float[np.ndarray, "samples legs"]:
    """A signal of all legs of a trace, such as phase or contact."""
    return trace[[f"{signal}_{leg}" for leg in range(1, springs_of(trace) + 2)]].to_numpy(float)


def relative_phases(part: pd.DataFrame) -> Float[np.ndarray, " springs"]:
    """Psi, rad, at the last sample before leg 1 touches down: on section 1.

    Args:
        part: the records of one row of a trace, in order of time.

    Raises:
        AnalysisError: leg 1 does not touch down in the recorded time.
    """
    contact = part["contact_1"].to_numpy(float) > 0.5
    down = np.flatnonzero(~contact[:-1] & contact[1:])
    lifted = np.flatnonzero(contact[:-1] & ~contact[1:])
    down = down[down > lifted[0]] if len(lifted) else down[:0]
    if not len(down):
        raise AnalysisError("Leg 1 does not touch down in the recorded time.")
    # a foot bounces after its touchdown and before it takes off: touchdowns end the long times in the air
    aloft = down - lifted[np.searchsorted(lifted, down) - 1]
    last = down[aloft > 0.5 * aloft.max()][-1]
    return np.mod(np.diff(of_legs(part, "phase")[last]), 2.0 * np.pi)


def largest_distance(table: pd.DataFrame) -> tuple[float, int] | None:
    """The largest distance of settled states from the nearest analytic solution on section 1, and its row.

    States without a gait do not count, since they are not solutions of the theory.

    Args:
        table: a settle table of the chain, with the column `distance` (rad).

    Returns:
        The distance, rad, and the row; None where the table has no such state.
    """
    if not {"distance", "gait", "status", "row"} <= set(table.columns):
        return None
    distance = np.asarray(table["distance"], float)
    settled = Status.SOUND.among(table["status"])
    labelled = ~table["gait"].isin(["locked", "none"]).to_numpy()
    counts = np.flatnonzero(settled & labelled & (distance <= NONE_BEYOND))
    if not len(counts):
        return None
    farthest = counts[distance[counts].argmax()]
    return float(distance[farthest]), int(np.asarray(table["row"])[farthest])
