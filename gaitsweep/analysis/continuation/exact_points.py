"""The exact place of a bifurcation that was bracketed on a branch."""

from __future__ import annotations

import numpy as np

from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.branch_points import CROSSINGS
from gaitsweep.analysis.continuation.critical_points import CriticalEquations, CriticalPoint, Vector
from gaitsweep.analysis.continuation.lockstep import Computation
from gaitsweep.analysis.continuation.normal_forms import critical_multiplier
from gaitsweep.engine.poincare.maps import sizes

# Most Newton steps to a bifurcation.
MOST_STEPS = 10
# Length of the step that ends the search.
LAST_STEP = 1e-13
# The largest change of scaled unknowns between a bifurcation that was bracketed and its exact place.
MOST_MOVED = 0.05


def equations_at(
    problem: ContinuationProblem,
    at: BranchPoints,
    special: str,
    second: tuple[str, float, float, float] | None = None,
) -> tuple[CriticalEquations, Vector]:
    """The equations of a bifurcation that was located on one branch (1,), and its unknowns.

    Args:
        problem: the continuation problem of the branch.
        at: the bifurcation.
        special: fold, flip, neimark_sacker, or a kind of branch point.
        second: name, lowest, highest and present value of a second parameter.
    """
    kind = "branch_point" if special in CROSSINGS else special
    k = len(problem.held.which)
    scale = np.concatenate([sizes(at.points.at)[0], np.ones(k)])
    names, low, high, here = (problem.parameter,), [problem.low], [problem.high], [at.parameter[0]]
    values = {name: column[:1] for name, column in problem.values.items()}
    if second is not None:
        names, low, high = (*names, second[0]), [*low, second[1]], [*high, second[2]]
        here.append(second[3])
        values.pop(second[0], None)
    width = np.array(high) - low
    equations = CriticalEquations(
        problem.mapping, kind, names, np.array(low), width, values, problem.held, scale
    )
    extra: list[float] = []
    if kind == "neimark_sacker":
        factors = np.linalg.eigvals(at.images.jacobian[0])
        extra = [float(np.angle(critical_multiplier(factors, kind)))]
    elif kind == "branch_point":
        extra = [0.0]
    z = np.concatenate([at.points.at[0], at.drift[0]]) / scale
    return equations, np.concatenate([z, (np.array(here) - low) / width, extra])


def located_exactly(
    problem: ContinuationProblem, at: BranchPoints, special: str
) -> Computation[CriticalPoint | None]:
    """The bifurcation next to a bracketed one (1,), to the precision of the map; None if not found."""
    equations, unknowns = equations_at(problem, at, special)
    first = unknowns
    border = yield from equations.first_border(at.points, unknowns)
    if border is None:
        return None
    last = np.inf
    for _ in range(MOST_STEPS):
        here = yield from equations.at(at.points, unknowns, border)
        if here is None:
            return None
        try:
            step = np.linalg.solve(here.matrix, -here.residual)
        except np.linalg.LinAlgError:
            return None
        size = float(np.max(np.abs(step)))
        if not np.max(np.abs(unknowns + step - first)) < MOST_MOVED:
            return None
        if size < LAST_STEP or (size > 0.3 * last and size < 1e-7):
            return here
        unknowns, border, last = unknowns + step, (here.v, here.w), size
    return None
