"""Bifurcations of fixed points as regular solutions of larger systems, in one parameter or in two.

At a bifurcation the matrix M = F_z + (1 - mu) E is singular: F = 0 are Newton's equations, E is one for
coordinates and zero for drifts, and mu is the critical multiplier, 1 at a fold, -1 at a flip and exp(i theta)
where a pair crosses the unit circle. A bordered system defines the test function g,
[M b; c' 0] [v; g] = [0; 1], which is zero there; v and the solution w of the transposed system are null
vectors. F = 0, g = 0 then has isolated solutions in one parameter and regular curves in two. Where branches
cross, [F_z F_p] has two null vectors, and F + beta b = 0 (the branching system).

Source: Govaerts 2000, Numerical Methods for Bifurcations of Dynamical Equilibria, chapters 4 and 8.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Complex, Float, Inexact

from gaitsweep.analysis.continuation.arclength import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.branch_points import CROSSINGS
from gaitsweep.analysis.continuation.lockstep import Computation, Request
from gaitsweep.analysis.continuation.multipliers import multipliers
from gaitsweep.analysis.continuation.newton import ConservedConstraints, matrices, residuals
from gaitsweep.analysis.continuation.normal_forms import (
    circle_coefficient,
    critical_multiplier,
    flip_coefficient,
)
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points, sizes

Vector = Float[np.ndarray, " unknowns"]  # coordinates, drifts, parameters, and theta or beta
NullVector = Inexact[np.ndarray, " fold_unknowns"]
Matrix = Float[np.ndarray, "equations unknowns"]
Multipliers = Complex[np.ndarray, " multipliers"]
# Steps of the central differences: along null vectors in scaled coordinates, of parameters as shares of their
# ranges.
ALONG, SHARE = 1e-3, 1e-5
# Most Newton steps to a bifurcation, and the last one that ends the search.
MOST_STEPS, LAST_STEP = 10, 1e-13
# The largest change of scaled unknowns between a bifurcation that was bracketed and its exact place.
MOST_MOVED = 0.05


@dataclasses.dataclass(frozen=True)
class CriticalPoint:
    """A bifurcation, with the derivatives of its equations.

    Attributes:
        point: one of `Points`.
        unknowns: scaled coordinates, drifts, parameters as shares of their ranges, and theta or beta, (n,).
        residual: of the equations, (k,).
        matrix: derivatives of the equations, (k, n).
        tangent: of the curve in two parameters, (n,); else empty.
        v, w: right and left null vectors of the singular matrix.
        multipliers: those of the map, on a curve in two parameters; else empty.
        tests: functions along a curve, by the name of the bifurcation of codimension 2 at their zeros.
        observed: the observables.
        corrections: number of corrections of the step that led there.
    """

    point: Points
    unknowns: Vector
    residual: Float[np.ndarray, " equations"]
    matrix: Matrix
    tangent: Vector
    v: Any
    w: Any
    multipliers: Multipliers
    tests: dict[str, float]
    observed: dict[str, float]
    corrections: int = 0


@dataclasses.dataclass(frozen=True)
class CriticalEquations:
    """The equations of one bifurcation.

    Attributes:
        mapping: the map.
        kind: fold, flip, neimark_sacker or branch_point.
        names: the parameters, one or two.
        low, width: (1,) or (2,) they scale the parameters.
        values: the other parameters.
        held: the constraints of conserved quantities.
        scale: of coordinates and drifts, (m,).
    """

    mapping: Map
    kind: str
    names: tuple[str, ...]
    low: Float[np.ndarray, " parameters"]
    width: Float[np.ndarray, " parameters"]
    values: dict[str, Any]
    held: ConservedConstraints
    scale: Float[np.ndarray, " fold_unknowns"]

    @property
    def m(self) -> int:
        """The number of coordinates and drifts."""
        return len(self.scale)

    def parameters(self, unknowns: Vector) -> Float[np.ndarray, " parameters"]:
        """The parameters of these unknowns."""
        return self.low + self.width * unknowns[self.m : self.m + len(self.names)]

    def evaluated(
        self, like: Points, several: Float[np.ndarray, "several unknowns"]
    ) -> Computation[
        tuple[
            Float[np.ndarray, "several fold_unknowns"],
            Float[np.ndarray, "several fold_unknowns columns"],
            MapEvaluation,
        ]
    ]:
        """F (n, m), its scaled derivatives (n, m, m + 1) with the first parameter last, and the images.

        `like` gives the modes; where the map is not defined, F and its derivatives are NaN.
        """
        n, size = len(several), like.at.shape[1]
        modes = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[:1], n, axis=0), like.modes)
        points = Points(several[:, :size] * self.scale[:size], modes)
        at = self.low + self.width * several[:, self.m : self.m + len(self.names)]
        values = {**self.values, **{name: at[:, k] for k, name in enumerate(self.names)}}
        images = yield Request(self.mapping, self.names[0], points, values)
        held = self.held[np.zeros(n, int)]
        miss = residuals(self.mapping, points, several[:, size : self.m], images, held) / self.scale
        slopes = np.concatenate([images.d_parameter, images.conserved_d_parameter[:, held.which]], axis=1)
        inner = matrices(images, held) * self.scale[None, None, :] / self.scale[None, :, None]
        full = np.concatenate([inner, (slopes * self.width[0] / self.scale)[:, :, None]], axis=2)
        miss[~images.sound], full[~images.sound] = np.nan, np.nan
        return miss, full, images

    def critical_matrix(
        self, derivatives: Float[np.ndarray, "fold_unknowns columns"], unknowns: Vector
    ) -> Inexact[np.ndarray, "fold_unknowns columns"]:
        """The matrix that is singular at the bifurcation, from the derivatives of F."""
        if self.kind == "branch_point":
            return derivatives
        return derivatives[:, :-1] + (1.0 - self.critical(unknowns)) * self._of_coordinates()

    def critical(self, unknowns: Vector) -> complex:
        """The multiplier on the unit circle."""
        if self.kind == "neimark_sacker":
            return complex(np.exp(1j * unknowns[-1]))
        return -1.0 if self.kind == "flip" else 1.0

    def _of_coordinates(self) -> Float[np.ndarray, "fold_unknowns fold_unknowns"]:
        diagonal = np.zeros(self.m)
        diagonal[: self.m - len(self.held.which)] = 1.0
        return np.diag(diagonal)

    def residual(
        self,
        unknowns: Vector,
        miss: Float[np.ndarray, " fold_unknowns"],
        derivatives: Float[np.ndarray, "fold_unknowns columns"],
        border: Any,
    ) -> tuple[Float[np.ndarray, " equations"], Any, Any]:
        """The residual, and the null vectors v and w, with the `border` (v, w) of a point close by."""
        matrix = self.critical_matrix(derivatives, unknowns)
        v, w, g = null_vectors(matrix, *border)
        if self.kind == "branch_point":
            miss = miss + unknowns[-1] * border[1][0]
        parts = [g.real, g.imag] if self.kind == "neimark_sacker" else [g.real]
        return np.concatenate([miss, np.ravel(parts)]), v, w

    def at(
        self,
        like: Points,
        unknowns: Vector,
        border: Any,
        before: Vector | None = None,
        corrections: int = 0,
    ) -> Computation[CriticalPoint | None]:
        """The point at some unknowns with its derivatives; None where the map is not differentiable.

        `border` are v and w of a point close by; the tangent has a positive product with `before`.
        """
        miss, full, images = yield from self.evaluated(like, unknowns[None])
        if not np.isfinite(full).all():
            return None
        residual, v, w = self.residual(unknowns, miss[0], full[0], border)
        if not np.isfinite(residual).all():
            return None
        m, q = self.m, len(self.names)
        directions = [v.real, v.imag] if self.kind == "neimark_sacker" else list(np.atleast_2d(v))
        shifts = []
        for direction in directions:
            shift = np.zeros(len(unknowns))
            shift[: len(direction)] = ALONG * direction
            shifts += [shift, -shift]
        for k in range(q):
            shift = np.zeros(len(unknowns))
            shift[m + k] = SHARE
            shifts += [shift, -shift]
        around, several, _ = yield from self.evaluated(like, unknowns + np.array(shifts))
        if not np.isfinite(several).all():
            return None
        ahead, behind = several[::2], several[1::2]
        along = len(directions)
        bends = list((ahead[:along] - behind[:along]) / (2.0 * ALONG))
        moved = list((ahead[along:] - behind[along:]) / (2.0 * SHARE))
        matrix = np.zeros((len(residual), len(unknowns)))
        matrix[:m, : m + 1] = full[0]
        if q == 2:
            matrix[:m, m + 1] = (around[-2] - around[-1]) / (2.0 * SHARE)
        self._derivatives_of_g(matrix, unknowns, v, w, border, bends, moved)
        tangent, factors, tests = np.zeros(0), np.zeros(0), {}
        if q == 2:
            tangent = np.linalg.svd(matrix)[2][-1]
            if before is not None and tangent @ before < 0.0:
                tangent = -tangent
            gradients = images.conserved_jacobian[:, self.held.which]
            factors = multipliers(images.jacobian, gradients)[0]
            second = (ahead[:along] - 2.0 * full[0] + behind[:along])[:, :, :-1] / ALONG**2
            first = [bend[:, :-1] for bend in bends]
            tests = self._tests(unknowns, full[0][:, :-1], v, w, factors, first, list(second))
        size = like.at.shape[1]
        point = Points(unknowns[None, :size] * self.scale[:size], like.modes)
        observed = {name: float(column[0]) for name, column in images.observed.items()}
        return CriticalPoint(
            point, unknowns, residual, matrix, tangent, v, w, factors, tests, observed, corrections
        )

    def _derivatives_of_g(
        self,
        matrix: Matrix,
        unknowns: Vector,
        v: Any,
        w: Any,
        border: Any,
        bends: list[Any],
        moved: list[Any],
    ) -> None:
        """Fill the rows of g in the matrix: second derivatives of F commute, so M_z v is M_v z."""
        m, q = self.m, len(self.names)
        if self.kind == "branch_point":
            matrix[:m, -1] = border[1][0]
            for k, bend in enumerate(bends):
                matrix[m + k, : m + 1] = -w[0] @ bend
                if q == 2:
                    matrix[m + k, m + 1] = -w[0] @ moved[1] @ v[k]
            return
        bend = bends[0] + 1j * bends[1] if len(bends) == 2 else bends[0]
        row = np.zeros(len(unknowns), complex)
        row[:m] = -w @ bend[:, :-1]
        for k in range(q):
            row[m + k] = -w @ moved[k][:, :-1] @ v
        if self.kind == "neimark_sacker":
            row[-1] = 1j * self.critical(unknowns) * (w @ self._of_coordinates() @ v)
            matrix[m], matrix[m + 1] = np.real(row), np.imag(row)
        else:
            matrix[m] = np.real(row)

    def _tests(
        self,
        unknowns: Vector,
        derivatives: Float[np.ndarray, "fold_unknowns fold_unknowns"],
        v: Any,
        w: Any,
        factors: Multipliers,
        first: list[Any],
        second: list[Any],
    ) -> dict[str, float]:
        """The functions that change sign at bifurcations of codimension 2 on a curve."""
        others = self.other_multipliers(unknowns, factors)
        i, k = np.triu_indices(len(others), 1)
        pairs = float(np.prod(1.0 - others[i] * others[k]).real)
        folds, flips = (float(np.prod(1.0 + sign * others).real) for sign in (-1.0, 1.0))
        free = not self.held.which
        jacobian = derivatives + self._of_coordinates()
        if self.kind == "neimark_sacker":
            turn = float(np.cos(unknowns[-1]))
            tests = {"resonance_1_3": turn + 0.5, "resonance_1_4": turn, "fold_neimark_sacker": folds}
            tests |= {"flip_neimark_sacker": flips, "double_neimark_sacker": pairs}
            if free:
                p = w / (w @ v)
                tests["chenciner"] = circle_coefficient(
                    jacobian, v, p, self.critical(unknowns), first, second
                )
            return tests
        if self.kind == "branch_point":
            return {"pitchfork_flip": flips, "pitchfork_neimark_sacker": pairs}
        meets = float((w @ self._of_coordinates() @ v).real)
        if self.kind == "fold":
            curvature = float(w @ first[0] @ v)
            tests = {"cusp": curvature, "resonance_1_1": meets, "fold_flip": flips}
            return {**tests, "fold_neimark_sacker": pairs}
        tests = {"resonance_1_2": meets, "fold_flip": folds, "flip_neimark_sacker": pairs}
        if free and meets != 0.0:
            tests["generalized_flip"] = flip_coefficient(jacobian, v, w / meets, first[0], second[0]) * abs(
                meets
            )
        return tests

    def other_multipliers(self, unknowns: Vector, factors: Multipliers) -> Multipliers:
        """The multipliers without the critical one, or the critical pair."""
        critical = self.critical(unknowns)
        rest = np.delete(factors, int(np.argmin(np.abs(factors - critical))))
        if self.kind == "neimark_sacker" and rest.size:
            rest = np.delete(rest, int(np.argmin(np.abs(rest - np.conj(critical)))))
        return rest

    def first(self, like: Points, unknowns: Vector) -> Computation[CriticalPoint | None]:
        """The first point at some unknowns; None where the map is not differentiable."""
        border = yield from self.first_border(like, unknowns)
        if border is None:
            return None
        return (yield from self.at(like, unknowns, border))

    def first_border(self, like: Points, unknowns: Vector) -> Computation[Any]:
        """The border of the first point, from the singular vectors; None where the map is not defined."""
        _, full, _ = yield from self.evaluated(like, unknowns[None])
        if not np.isfinite(full).all():
            return None
        left, _, right = np.linalg.svd(self.critical_matrix(full[0], unknowns))
        if self.kind == "branch_point":
            return right[-2:], left[:, -1:].T
        return right[-1].conj(), left[:, -1].conj()


def null_vectors(matrix: Any, v: Any, w: Any) -> tuple[Any, Any, Any]:
    """The null vectors v, w, of length 1, and g, of a matrix bordered by v and w of a point close by.

    A matrix (m, m + 1) of a branch point has two of v (2, m + 1), one of w (1, m) and two of g. All are NaN
    where the bordered matrix is singular.
    """
    rows, columns = matrix.shape
    right, left = np.atleast_2d(v), np.atleast_2d(w)
    full = np.zeros((rows + len(right), columns + len(left)), np.result_type(matrix, right))
    full[:rows, :columns] = matrix
    full[:rows, columns:] = left.conj().T
    full[rows:, :columns] = right.conj()
    unit = np.zeros((len(full), len(right)), full.dtype)
    unit[rows:] = np.eye(len(right))
    transposed = np.zeros((len(full), len(left)), full.dtype)
    transposed[columns:] = np.eye(len(left))
    try:
        solved, adjoint = np.linalg.solve(full, unit), np.linalg.solve(full.T, transposed)
    except np.linalg.LinAlgError:  # several multipliers are critical at once
        solved, adjoint = np.full_like(unit, np.nan), np.full_like(transposed, np.nan)
    new_v, new_w, g = solved[:columns].T, adjoint[:rows].T, solved[columns:].T[:, 0]
    lengths, of_w = np.linalg.norm(new_v, axis=1), np.linalg.norm(new_w)
    new_v, new_w, g = new_v / lengths[:, None], new_w / of_w, g / (lengths * of_w)
    return (new_v, new_w, g) if len(right) == 2 else (new_v[0], new_w[0], g[0])


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
