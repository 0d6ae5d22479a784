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
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Complex, Float, Inexact

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.branch_points import CROSSINGS
from gaitsweep.analysis.continuation.floquet_multipliers import critical_multiplier, multipliers
from gaitsweep.analysis.continuation.lockstep import Computation, Request
from gaitsweep.analysis.continuation.newton import ConservedConstraints, matrices, residuals, scales
from gaitsweep.analysis.continuation.normal_forms import (
    flip_coefficient,
    hopf_form,
    neimark_sacker_coefficient,
)
from gaitsweep.engine.poincare.maps import Map, MapEvaluation, Points
from gaitsweep.engine.poincare.stationary_map import StationaryMap

Vector = Float[np.ndarray, " unknowns"]  # coordinates, drifts, parameters, and theta or beta
Matrix = Float[np.ndarray, "equations unknowns"]
FoldMatrix = Float[np.ndarray, "fold_unknowns columns"]  # derivatives of F
Multipliers = Complex[np.ndarray, " multipliers"]
CriticalKind = Literal["fold", "flip", "neimark_sacker", "branch_point"]
# One null vector; of a branch point two of v (2, m + 1) and one of w (1, m).
NullVectors = Inexact[np.ndarray, " ..."]
# Steps of the central differences along null vectors, in scaled coordinates.
ALONG = 1e-3
# Steps of the central differences of parameters, as shares of their ranges.
PARAMETER_STEP = 1e-5
# A multiplier is real if its imaginary part is below this share of its modulus.
REAL = 1e-6


class Border(NamedTuple):
    """The null vectors v and w of a point close by, which border the singular matrix."""

    v: NullVectors
    w: NullVectors


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
    v: NullVectors
    w: NullVectors
    multipliers: Multipliers
    tests: dict[str, float]
    observed: dict[str, float]
    corrections: int = 0


class _Differences(NamedTuple):
    """Central differences of F and of its derivatives at a point.

    `first`, `second`: first and second differences of the derivatives along each null vector; `moved`: their
    change with each parameter, as a share of its range; `by_second`: the change of F with the last parameter.
    """

    first: list[FoldMatrix]
    second: list[FoldMatrix]
    moved: list[FoldMatrix]
    by_second: Float[np.ndarray, " fold_unknowns"]


@dataclasses.dataclass(frozen=True)
class CriticalEquations:
    """The equations of one bifurcation.

    Attributes:
        mapping: the map.
        kind: the bifurcation.
        names: the parameters, one or two.
        low, width: (1,) or (2,) they scale the parameters.
        values: the other parameters.
        constraints: those of conserved quantities.
        scale: of coordinates and drifts, (m,).
    """

    mapping: Map
    kind: CriticalKind
    names: tuple[str, ...]
    low: Float[np.ndarray, " parameters"]
    width: Float[np.ndarray, " parameters"]
    values: dict[str, Any]
    constraints: ConservedConstraints
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
        """F at scaled unknowns (n, ...), with the modes of a point `like` (1,), its derivatives, and images.

        F (n, m) and its derivatives (n, m, m + 1), with the first parameter last, are scaled, and NaN where
        the map is not defined.
        """
        n, size = len(several), like.at.shape[1]
        modes = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[:1], n, axis=0), like.modes)
        points = Points(several[:, :size] * self.scale[:size], modes)
        at = self.low + self.width * several[:, self.m : self.m + len(self.names)]
        values = {**self.values, **{name: at[:, k] for k, name in enumerate(self.names)}}
        images = yield Request(self.mapping, self.names[0], points, values)
        constraints = self.constraints[np.zeros(n, int)]
        miss = residuals(self.mapping, points, several[:, size : self.m], images, constraints) / self.scale
        conserved_slopes = images.conserved_d_parameter[:, constraints.which]
        slopes = np.concatenate([images.d_parameter, conserved_slopes], axis=1)
        inner = matrices(images, constraints) * self.scale[None, None, :] / self.scale[None, :, None]
        full = np.concatenate([inner, (slopes * self.width[0] / self.scale)[:, :, None]], axis=2)
        miss[~images.sound] = np.nan
        full[~images.sound] = np.nan
        return miss, full, images

    def critical_matrix(
        self, derivatives: FoldMatrix, unknowns: Vector
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
        diagonal[: self.m - len(self.constraints.which)] = 1.0
        return np.diag(diagonal)

    def residual(
        self,
        unknowns: Vector,
        miss: Float[np.ndarray, " fold_unknowns"],
        derivatives: FoldMatrix,
        border: Border,
    ) -> tuple[Float[np.ndarray, " equations"], NullVectors, NullVectors]:
        """The residual of the equations at a point, and the null vectors v and w there.

        `border` is that of a point close by.
        """
        matrix = self.critical_matrix(derivatives, unknowns)
        v, w, g = null_vectors(matrix, *border)
        if self.kind == "branch_point":
            miss = miss + unknowns[-1] * border.w[0]
        parts = [g.real, g.imag] if self.kind == "neimark_sacker" else [g.real]
        return np.concatenate([miss, np.ravel(parts)]), v, w

    def at(
        self,
        like: Points,
        unknowns: Vector,
        border: Border,
        before: Vector | None = None,
        corrections: int = 0,
    ) -> Computation[CriticalPoint | None]:
        """The point at some unknowns with its derivatives; None where the map is not differentiable.

        The tangent has a positive product with `before`.
        """
        miss, full, images = yield from self.evaluated(like, unknowns[None])
        if not np.isfinite(full).all():
            return None
        residual, v, w = self.residual(unknowns, miss[0], full[0], border)
        if not np.isfinite(residual).all():
            return None
        near = yield from self._differences(like, unknowns, full[0], v)
        if near is None:
            return None
        matrix = np.zeros((len(residual), len(unknowns)))
        matrix[: self.m, : self.m + 1] = full[0]
        self._derivatives_of_g(matrix, unknowns, v, w, border, near)
        size = like.at.shape[1]
        point = Points(unknowns[None, :size] * self.scale[:size], like.modes)
        observed = {name: float(column[0]) for name, column in images.observed.items()}
        tangent, factors, tests = np.zeros(0), np.zeros(0), {}
        if len(self.names) == 2:
            matrix[: self.m, self.m + 1] = near.by_second
            tangent = np.linalg.svd(matrix)[2][-1]
            if before is not None and tangent @ before < 0.0:
                tangent = -tangent
            gradients = images.conserved_jacobian[:, self.constraints.which]
            factors = multipliers(images.jacobian, gradients)[0]
            tests = self._tests(unknowns, full[0][:, :-1], v, w, factors, near)
            if isinstance(self.mapping, StationaryMap) and self.kind == "neimark_sacker":
                tests = self._hopf_tests(self.mapping, point, unknowns, tests)
        return CriticalPoint(
            point, unknowns, residual, matrix, tangent, v, w, factors, tests, observed, corrections
        )

    def _hopf_tests(
        self, mapping: StationaryMap, point: Points, unknowns: Vector, tests: dict[str, float]
    ) -> dict[str, float]:
        """The tests of a curve of Hopf points: a flow has no resonances, and another cubic term."""
        parameters = dict(zip(self.names, self.parameters(unknowns)[:, None], strict=True))
        cubic = hopf_form(mapping, point, {**self.values, **parameters}).l1
        return {
            "fold_neimark_sacker": tests["fold_neimark_sacker"],
            "double_neimark_sacker": tests["double_neimark_sacker"],
            "chenciner": cubic,
        }

    def _differences(
        self, like: Points, unknowns: Vector, derivatives: FoldMatrix, v: NullVectors
    ) -> Computation[_Differences | None]:
        """The change of F's `derivatives` along the null vectors v and with the parameters.

        None where the map is not differentiable close by.
        """
        directions = [np.real(v), np.imag(v)] if self.kind == "neimark_sacker" else list(np.atleast_2d(v))
        shifts = []
        for direction in directions:
            shift = np.zeros(len(unknowns))
            shift[: len(direction)] = ALONG * direction
            shifts += [shift, -shift]
        for k in range(len(self.names)):
            shift = np.zeros(len(unknowns))
            shift[self.m + k] = PARAMETER_STEP
            shifts += [shift, -shift]
        around, several, _ = yield from self.evaluated(like, unknowns + np.array(shifts))
        if not np.isfinite(several).all():
            return None
        ahead, behind = several[::2], several[1::2]
        along = len(directions)
        return _Differences(
            first=list((ahead[:along] - behind[:along]) / (2.0 * ALONG)),
            second=list((ahead[:along] - 2.0 * derivatives + behind[:along])[:, :, :-1] / ALONG**2),
            moved=list((ahead[along:] - behind[along:]) / (2.0 * PARAMETER_STEP)),
            by_second=(around[-2] - around[-1]) / (2.0 * PARAMETER_STEP),
        )

    def _derivatives_of_g(
        self,
        matrix: Matrix,
        unknowns: Vector,
        v: NullVectors,
        w: NullVectors,
        border: Border,
        near: _Differences,
    ) -> None:
        """Fill the rows of g in the matrix: second derivatives of F commute, so M_z v is M_v z."""
        m, q, bends, moved = self.m, len(self.names), near.first, near.moved
        if self.kind == "branch_point":
            matrix[:m, -1] = border.w[0]
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
        v: NullVectors,
        w: NullVectors,
        factors: Multipliers,
        near: _Differences,
    ) -> dict[str, float]:
        """The functions that change sign at bifurcations of codimension 2 on a curve."""
        first = [bend[:, :-1] for bend in near.first]
        others = self.other_multipliers(unknowns, factors)
        i, k = np.triu_indices(len(others), 1)
        pairs = float(np.prod(1.0 - others[i] * others[k]).real)
        folds, flips = (float(np.prod(1.0 + sign * others).real) for sign in (-1.0, 1.0))
        E = self._of_coordinates()
        jacobian = derivatives + E
        if self.kind == "neimark_sacker":
            turn = float(np.cos(unknowns[-1]))
            tests = {"resonance_1_3": turn + 0.5, "resonance_1_4": turn, "fold_neimark_sacker": folds}
            tests |= {"flip_neimark_sacker": flips, "double_neimark_sacker": pairs}
            p = w / (w @ E @ v)
            tests["chenciner"] = neimark_sacker_coefficient(
                jacobian, E, v, p, self.critical(unknowns), first, near.second
            )
            return tests
        if self.kind == "branch_point":
            return {"pitchfork_flip": flips, "pitchfork_neimark_sacker": pairs}
        meets = float(np.real(w @ E @ v))
        if self.kind == "fold":
            curvature = float(w @ first[0] @ v)
            tests = {"cusp": curvature, "resonance_1_1": meets, "fold_flip": flips}
            return {**tests, "fold_neimark_sacker": pairs}
        tests = {"resonance_1_2": meets, "fold_flip": folds, "flip_neimark_sacker": pairs}
        if meets != 0.0:
            tests["generalized_flip"] = flip_coefficient(
                jacobian, E, v, w / meets, first[0], near.second[0]
            ) * abs(meets)
        return tests

    def other_multipliers(self, unknowns: Vector, factors: Multipliers) -> Multipliers:
        """The multipliers without the critical one, or the critical pair."""
        critical = self.critical(unknowns)
        others = np.delete(factors, int(np.argmin(np.abs(factors - critical))))
        if self.kind == "neimark_sacker" and others.size:
            others = np.delete(others, int(np.argmin(np.abs(others - np.conj(critical)))))
        return others

    def is_critical(self, name: str, at: CriticalPoint) -> bool:
        """Whether the zero of a test function is a bifurcation: that of pairs may be a neutral saddle."""
        of_pairs = name.endswith("neimark_sacker") and self.kind != "neimark_sacker"
        if not of_pairs and name != "double_neimark_sacker":
            return True
        others = self.other_multipliers(at.unknowns, at.multipliers)
        i, k = np.triu_indices(len(others), 1)
        nearest = others[i[np.argmin(np.abs(1.0 - others[i] * others[k]))]]
        return bool(abs(np.imag(nearest)) > REAL * abs(nearest))

    def first(self, like: Points, unknowns: Vector) -> Computation[CriticalPoint | None]:
        """The first point at some unknowns; None where the map is not differentiable."""
        border = yield from self.first_border(like, unknowns)
        if border is None:
            return None
        return (yield from self.at(like, unknowns, border))

    def first_border(self, like: Points, unknowns: Vector) -> Computation[Border | None]:
        """The border of the first point, from the singular vectors; None where the map is not defined."""
        _, full, _ = yield from self.evaluated(like, unknowns[None])
        if not np.isfinite(full).all():
            return None
        left, _, right = np.linalg.svd(self.critical_matrix(full[0], unknowns))
        if self.kind == "branch_point":
            return Border(right[-2:], left[:, -1:].T)
        return Border(right[-1].conj(), left[:, -1].conj())


def null_vectors(
    matrix: Inexact[np.ndarray, "fold_unknowns columns"], v: NullVectors, w: NullVectors
) -> tuple[NullVectors, NullVectors, Any]:
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
    scale = scales(problem.mapping, at.points, at.images, problem.constraints)[0]
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
        gradients = at.images.conserved_jacobian[:, problem.constraints.which]
        factors = multipliers(at.images.jacobian, gradients)[0]
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
