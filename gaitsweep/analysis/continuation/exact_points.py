"""The exact place of a bifurcation that was bracketed on a branch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.branch_points import CROSSINGS
from gaitsweep.analysis.continuation.critical_points import (
    Border,
    CriticalEquations,
    CriticalKind,
    CriticalPoint,
    Vector,
)
from gaitsweep.analysis.continuation.floquet_multipliers import critical_multiplier
from gaitsweep.analysis.continuation.lockstep import Computation
from gaitsweep.engine.poincare.maps import sizes

# Most Newton steps to a bifurcation.
MOST_STEPS = 10
# Length of the step that ends the search.
LAST_STEP = 1e-13
# The search also ends with a step this short that is longer than this share of the step before: it converges
# no further.
NEARLY_LAST_STEP = 1e-7
SLOWER = 0.3
# The largest change of scaled unknowns between a bifurcation that was bracketed and its exact place.
MOST_MOVED = 0.05


class SecondParameter(NamedTuple):
    """The second parameter of a plane: its name, and its range."""

    name: str
    low: float
    high: float


def critical_kind(special: str) -> CriticalKind:
    """The kind of equations of a bifurcation on a branch: those of all branch points are the same.

    Args:
        special: fold, flip, neimark_sacker, or a kind of branch point.
    """
    if special == "fold" or special == "flip" or special == "neimark_sacker":
        return special
    assert special in CROSSINGS
    return "branch_point"


def equations_at(
    problem: ContinuationProblem, at: BranchPoints, special: str, second: SecondParameter | None = None
) -> tuple[CriticalEquations, Vector]:
    """The equations of a bifurcation that was located on one branch (1,), and its unknowns.

    Args:
        problem: the continuation problem of the branch.
        at: the bifurcation.
        special: fold, flip, neimark_sacker, or a kind of branch point.
        second: a second parameter, one of the problem's other parameters.

    Returns:
        The equations, and the unknowns at the bifurcation.
    """
    kind = critical_kind(special)
    k = len(problem.constraints.which)
    scale = np.concatenate([sizes(at.points.at)[0], np.ones(k)])
    parameters = [(problem.parameter, problem.low, problem.high, float(at.parameter[0]))]
    values = {name: column[:1] for name, column in problem.values.items()}
    if second is not None:
        present_value = float(values.pop(second.name)[0])
        parameters.append((second.name, second.low, second.high, present_value))
    names = tuple(name for name, *_ in parameters)
    low, high, present = np.array([numbers for _, *numbers in parameters]).T
    width = high - low
    equations = CriticalEquations(
        problem.mapping, kind, names, low, width, values, problem.constraints, scale
    )
    extra: list[float] = []
    if kind == "neimark_sacker":
        factors = np.linalg.eigvals(at.images.jacobian[0])
        extra = [float(np.angle(critical_multiplier(factors, kind)))]
    elif kind == "branch_point":
        extra = [0.0]
    z = np.concatenate([at.points.at[0], at.drift[0]]) / scale
    return equations, np.concatenate([z, (present - low) / width, extra])


def located_exactly(
    problem: ContinuationProblem, at: BranchPoints, special: str
) -> Computation[CriticalPoint | None]:
    """The bifurcation next to a bracketed one (1,), to the precision of the map; None if not found.

    Args:
        problem: the continuation problem of the branch.
        at: the bracketed bifurcation.
        special: fold, flip, neimark_sacker, or a kind of branch point.
    """
    equations, unknowns = equations_at(problem, at, special)
    first = unknowns
    border = yield from equations.first_border(at.points, unknowns)
    if border is None:
        return None
    last = np.inf
    for _ in range(MOST_STEPS):
        point = yield from equations.at(at.points, unknowns, border)
        if point is None:
            return None
        try:
            step = np.linalg.solve(point.matrix, -point.residual)
        except np.linalg.LinAlgError:
            return None
        size = float(np.max(np.abs(step)))
        if not np.max(np.abs(unknowns + step - first)) < MOST_MOVED:
            return None
        if size < LAST_STEP or (size > SLOWER * last and size < NEARLY_LAST_STEP):
            return point
        unknowns, border, last = unknowns + step, Border(point.v, point.w), size
    return None
