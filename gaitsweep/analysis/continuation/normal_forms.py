"""Coefficients of the normal forms of bifurcations of maps, whose signs say whether they are supercritical.

The quadratic and cubic terms of the map come from Jacobians beside the bifurcation: B(u, h) is the derivative
of J h along u, and C(u, u, h) the second one.

Source: Kuznetsov 2004, Elements of Applied Bifurcation Theory, section 5.4 (by projection on the critical
directions); of flows at Hopf points, and the cycles that begin there, eq. (3.20).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.floquet_multipliers import (
    ComplexVector,
    CriticalEigenvectors,
    Matrix,
    Vector,
    critical_eigenvectors,
    critical_multiplier,
    multipliers,
)
from gaitsweep.analysis.continuation.newton import ConservedConstraints, matrices
from gaitsweep.engine.poincare.maps import MIN_SCALE, MapEvaluation, Points, Values
from gaitsweep.engine.poincare.stationary_map import StationaryMap, flow_derivatives, linearised_flow
from gaitsweep.errors import ArgumentError


@dataclasses.dataclass(frozen=True)
class HopfForm:
    """The normal form of a Hopf point: z' = i frequency z + cubic z |z|^2, x = 2 Re(z q) + ...

    Attributes:
        frequency: the imaginary part of the critical eigenvalue, rad/s.
        q, p: its right and left eigenvectors, p . q = 1, |q| = 1 in the units of the coordinates.
        cubic: the cubic coefficient, 1/s.
        h11, h20: the second-order terms of x, h11 |z|^2 + Re(h20 z^2).
    """

    frequency: float
    q: ComplexVector
    p: ComplexVector
    cubic: complex
    h11: Vector
    h20: ComplexVector

    @property
    def l1(self) -> float:
        """The first Lyapunov coefficient; below 0, stable cycles begin (supercritical)."""
        return self.cubic.real / self.frequency


def hopf_form(mapping: StationaryMap, at: Points, values: Values) -> HopfForm:
    """The normal form at a Hopf point (1,), by exact derivatives of the flow.

    Args:
        mapping: the map of the flow's stationary points.
        at: the Hopf point.
        values: the parameters there.

    Raises:
        ArgumentError: no two eigenvalues of the flow are complex there.
    """
    values_at = {name: column[0] for name, column in mapping.complete(values, 1).items()}
    hopf_point = values_at, at.at[0], at[0].modes
    J = np.asarray(linearised_flow(mapping)(*hopf_point)[1])
    eigenvalues = np.linalg.eigvals(J)
    upper = eigenvalues[np.imag(eigenvalues) > 0.0]
    if not upper.size:
        raise ArgumentError("The point is no Hopf point: all eigenvalues of the flow are real there.")
    eigenvalue, q, p = critical_eigenvectors(J, complex(upper[np.argmin(np.abs(np.real(upper)))]))
    a, b, frequency = np.real(q), np.imag(q), eigenvalue.imag

    def derivatives(*directions: tuple[Vector, Vector, Vector]) -> tuple[np.ndarray, np.ndarray]:
        """The second derivatives along two directions of each triple, and the third along all of them."""
        second, third = flow_derivatives(mapping)(*hopf_point, *np.swapaxes(directions, 0, 1))
        return np.asarray(second), np.asarray(third)

    (aa, bb, ab, *_), (aaa, bbb, abb, aab, *_) = derivatives(
        *((a, a, a), (b, b, b), (a, b, b), (b, a, a)), *[(a, a, a)] * 2
    )
    h11 = np.linalg.solve(-J, aa + bb)
    h20 = np.linalg.solve(2j * frequency * np.eye(len(J)) - J, aa - bb + 2j * ab)
    pairs = ((a, h11), (b, h11), (a, np.real(h20)), (b, np.imag(h20)), (a, np.imag(h20)), (b, np.real(h20)))
    (a_11, b_11, a_r, b_i, a_i, b_r), _ = derivatives(*((u, v, u) for u, v in pairs))
    cubic = aaa + abb + 1j * (aab + bbb) + 2.0 * (a_11 + 1j * b_11) + a_r + b_i + 1j * (a_i - b_r)
    return HopfForm(frequency, q, p, complex(p @ cubic) / 2.0, h11, h20)


def hopf_cycle(
    mapping: StationaryMap, at: Points, values: Values, parameter: str, amplitude: float, count: int
) -> pd.DataFrame:
    """The cycle of an amplitude that begins at a Hopf point (1,), to second order.

    Args:
        mapping: the map.
        at: the Hopf point.
        values: the parameters there.
        parameter: the parameter that moves away from there.
        amplitude: the largest displacement of the cycle, in the units of the coordinates.
        count: the number of its points.

    Returns:
        One record a point: time (s), the coordinates, the parameter's value at which the cycle has this
        amplitude, and its period (s).
    """
    form, program = hopf_form(mapping, at, values), linearised_flow(mapping)
    values_at = {name: column[0] for name, column in mapping.complete(values, 1).items()}
    x, modes, value = at.at[0], at[0].modes, values_at[parameter]

    def linearised(value: Any, x: Any) -> Any:
        """The rates and their Jacobian at x, at a value of the parameter."""
        return program({**values_at, parameter: value}, x, modes)

    (_, J), (by_parameter, _) = jax.jvp(linearised, (value, x), (1.0, np.zeros_like(x)))
    branch = np.linalg.solve(-np.asarray(J), np.asarray(by_parameter))
    # the derivative of the critical eigenvalue along the branch of stationary points
    _, (_, J_rate) = jax.jvp(linearised, (value, x), (1.0, branch))
    eigenvalue_rate = complex(form.p @ np.asarray(J_rate) @ form.q)
    radius = amplitude / np.max(np.abs(form.q)) / 2.0
    change = -form.cubic.real * radius**2 / eigenvalue_rate.real
    frequency = form.frequency + eigenvalue_rate.imag * change + form.cubic.imag * radius**2
    phase = 2.0 * np.pi * np.arange(count) / count
    z = radius * np.exp(1j * phase)[:, None]
    points = (
        x + change * branch + 2.0 * (z * form.q).real + np.abs(z) ** 2 * form.h11 + (z**2 * form.h20).real
    )
    columns = {quantity.name: points[:, k] for k, quantity in enumerate(mapping.coordinates)}
    period = 2.0 * np.pi / frequency
    return pd.DataFrame({"time": phase / frequency, **columns, parameter: value + change, "period": period})


# Step of the differences of Jacobians, in coordinates relative to their scales.
BESIDE = 1e-3
# Largest length of the left critical eigenvector, which is infinite where two multipliers are critical with
# one direction.
LARGEST_LEFT = 1e6
# Kinds of bifurcations that have a coefficient.
PITCHFORKS = ("supercritical_pitchfork", "subcritical_pitchfork")
SIMPLE = ("fold", "transcritical", "flip", "neimark_sacker", *PITCHFORKS)


def coefficient(problem: ContinuationProblem, at: BranchPoints, kind: str) -> float:
    """The leading coefficient of the normal form at a bifurcation of one branch (1,).

    The critical coordinate x is a displacement along the critical direction, which has length 1 in units of
    the coordinates' scales (rad for angles, else 0.1 + their size):

    - fold, transcritical: a of x -> x + a x^2.
    - flip: b of x -> -x + b x^3; supercritical, to a stable cycle of twice the period, where b > 0.
    - pitchfork: c of x -> x + c x^3; supercritical where c < 0.
    - neimark_sacker: d of |x| -> |x| (1 + d |x|^2); supercritical where d < 0. At a Hopf point of a flow, the
      first Lyapunov coefficient instead, as of `HopfForm`.

    Args:
        problem: the continuation problem of the branch.
        at: the bifurcation.
        kind: its kind.

    Where conserved quantities are constrained, the normal form is that of the map on their level set.

    Returns:
        NaN for other kinds, and where the map has a corner beside the point.
    """
    if kind not in SIMPLE:
        return float("nan")
    if isinstance(problem.mapping, StationaryMap) and kind == "neimark_sacker":
        return hopf_form(problem.mapping, at.points, problem.values_at(at.parameter)).l1
    # an angle is measured in rad wherever it is cut
    of_coordinates = np.where(problem.mapping.circular, 1.0, MIN_SCALE + np.abs(at.points.at[0]))
    size, constraints = len(of_coordinates), problem.constraints
    # a conserved quantity by its gradient, whatever its unit
    steepness = np.linalg.norm(at.images.conserved_jacobian[0, constraints.which] * of_coordinates, axis=1)
    scale = np.append(of_coordinates, np.where(steepness > 0.0, steepness, 1.0))
    J = _extended(at.images, constraints, scale)[0]
    if not np.isfinite(J).all():
        return float("nan")
    E = np.diag(np.arange(len(J)) < size).astype(float)
    multiplier, q, p = _critical_vectors(J, E, at.images, constraints, kind)
    if not np.linalg.norm(p) < LARGEST_LEFT:
        return float("nan")
    directions = [np.real(q)] if kind != "neimark_sacker" else [np.real(q), np.imag(q)]
    # less far along coordinates whose scale in the map is smaller
    own = np.where(problem.mapping.circular, 1.0, problem.mapping.sizes(at.points.at)[0])
    step = BESIDE / max(1.0, *(np.max(np.abs(u[:size]) * of_coordinates / own) for u in directions))
    beside = [sign * step * u[:size] for u in directions for sign in (1.0, -1.0)]
    first_branch = np.zeros(len(beside), int)
    points = Points(at.points.at + np.stack(beside) * of_coordinates, at.points[first_branch].modes)
    images = problem[first_branch].evaluated(points, at.parameter[first_branch])
    if not images.sound.all():
        return float("nan")
    jacobians = _extended(images, constraints, scale)
    if not np.isfinite(jacobians).all():
        return float("nan")
    pairs = list(zip(jacobians[::2], jacobians[1::2], strict=True))
    first = [(ahead - behind) / (2.0 * step) for ahead, behind in pairs]
    second = [(ahead - 2.0 * J + behind) / step**2 for ahead, behind in pairs]
    if kind == "neimark_sacker":
        return neimark_sacker_coefficient(J, E, q, p, multiplier, first, second)
    q, p = np.real(q), np.real(p)
    B, C = first[0], second[0]
    quadratic = B @ q
    if kind in ("fold", "transcritical"):
        return float(0.5 * p @ quadratic)
    if kind == "flip":
        return flip_coefficient(J, E, q, p, B, C)
    bordered = np.block([[J - E, q[:, None]], [p[None], np.zeros((1, 1))]])
    h = np.linalg.solve(bordered, np.append(quadratic - (p @ quadratic) * q, 0.0))[:-1]
    return float(p @ (C @ q / 6.0 - 0.5 * B @ h))


def _extended(
    images: MapEvaluation, constraints: ConservedConstraints, scale: Float[np.ndarray, " unknowns"]
) -> Float[np.ndarray, "points unknowns unknowns"]:
    """The Jacobians in scaled coordinates, with rows and columns of the constraints as in `matrices`."""
    full = matrices(images, constraints)
    size = images.jacobian.shape[1]
    full[:, :size, :size] = images.jacobian
    return full * scale / scale[:, None]


def _critical_vectors(
    J: Matrix, E: Matrix, images: MapEvaluation, constraints: ConservedConstraints, kind: str
) -> CriticalEigenvectors:
    """The critical multiplier with its eigenvectors, (J - multiplier E) q = 0, p . E q = 1."""
    if not constraints.which:
        return critical_eigenvectors(J, critical_multiplier(np.linalg.eigvals(J), kind))
    factors = multipliers(images.jacobian, images.conserved_jacobian[:, constraints.which])[0]
    multiplier = critical_multiplier(factors, kind)
    left, _, right = np.linalg.svd(J - multiplier * E)
    q, p = right[-1].conj().astype(complex), left[:, -1].conj()
    q = q * np.exp(-1j * np.angle(q[np.argmax(np.abs(q))]))
    return CriticalEigenvectors(multiplier, q, p / (p @ E @ q))


def flip_coefficient(J: Matrix, E: Matrix, q: Vector, p: Vector, first: Matrix, second: Matrix) -> float:
    """The coefficient of a flip, from the first and second derivative of the Jacobian along q; p . E q = 1.

    Args:
        J: the Jacobian, (size, size), with rows and columns of constraints where there are any.
        E: one for each coordinate and zero for each constraint, (size, size).
        q, p: its right and left critical eigenvectors, (size,).
        first, second: first and second derivative of the Jacobian along q, (size, size).
    """
    inner = np.linalg.solve(E - J, first @ q)
    return float(p @ (second @ q / 6.0 + 0.5 * first @ inner))


def neimark_sacker_coefficient(
    J: Matrix,
    E: Matrix,
    q: ComplexVector,
    p: ComplexVector,
    multiplier: complex,
    first: list[Matrix],
    second: list[Matrix],
) -> float:
    """The coefficient of a Neimark-Sacker bifurcation.

    Args:
        J, E: as in `flip_coefficient`.
        q, p: its right and left critical eigenvectors, (size,), p . E q = 1.
        multiplier: the critical multiplier.
        first, second: first and second derivatives of the Jacobian along the real and the imaginary part of
            q, (size, size) each.
    """
    unit = multiplier / abs(multiplier)
    B, conjugate = first[0] + 1j * first[1], first[0] - 1j * first[1]
    cubic = (second[0] + second[1]) @ q
    mixed = 2.0 * B @ np.linalg.solve(E - J, B @ q.conj())
    double = conjugate @ np.linalg.solve(unit**2 * E - J, B @ q)
    return float(0.5 * (p @ (cubic + mixed + double) / unit).real)


def doubled_direction(at: BranchPoints) -> Vector:
    """The direction in which the cycle of twice the period leaves a flip of one branch (1,)."""
    return np.real(critical_eigenvectors(at.images.jacobian[0], -1.0).right)
