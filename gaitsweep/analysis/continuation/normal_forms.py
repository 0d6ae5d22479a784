"""Coefficients of the normal forms of bifurcations of maps, whose signs say whether they are supercritical.

The quadratic and cubic terms of the map come from Jacobians beside the bifurcation: B(u, h) is the derivative
of J h along u, and C(u, u, h) the second one.

Source: Kuznetsov 2004, Elements of Applied Bifurcation Theory, section 5.4 (by projection on the critical
directions).
"""

from __future__ import annotations

import numpy as np

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.floquet_multipliers import (
    ComplexVector,
    Matrix,
    Vector,
    critical_eigenvectors,
    critical_multiplier,
)
from gaitsweep.analysis.continuation.hopf_cycles import hopf_form
from gaitsweep.engine.poincare.maps import Points, sizes
from gaitsweep.engine.poincare.stationary_map import StationaryMap

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

    The critical coordinate x is in units of the coordinates' scales (rad for angles, else 0.1 + their size):

    - fold, transcritical: a of x -> x + a x^2.
    - flip: b of x -> -x + b x^3; supercritical, to a stable cycle of twice the period, where b > 0.
    - pitchfork: c of x -> x + c x^3; supercritical where c < 0.
    - neimark_sacker: d of |x| -> |x| (1 + d |x|^2); supercritical where d < 0. At a Hopf point of a flow, the
      first Lyapunov coefficient instead, as of `HopfForm`.

    Args:
        problem: the continuation problem of the branch.
        at: the bifurcation.
        kind: its kind.

    Returns:
        NaN for other kinds, where the map has a corner beside the point, and where conserved quantities are
        constrained.
    """
    if kind not in SIMPLE or problem.constraints.which:
        return float("nan")
    if isinstance(problem.mapping, StationaryMap) and kind == "neimark_sacker":
        return hopf_form(problem.mapping, at.points, problem.values_at(at.parameter)).l1
    # an angle is measured in rad wherever it is cut
    scale = np.where(problem.mapping.circular, 1.0, sizes(at.points.at)[0])
    J = at.images.jacobian[0] * scale / scale[:, None]
    if not np.isfinite(J).all():
        return float("nan")
    multiplier, q, p = critical_eigenvectors(J, critical_multiplier(np.linalg.eigvals(J), kind))
    if not np.linalg.norm(p) < LARGEST_LEFT:
        return float("nan")
    directions = [np.real(q)] if kind != "neimark_sacker" else [np.real(q), np.imag(q)]
    beside = [sign * BESIDE * u for u in directions for sign in (1.0, -1.0)]
    first_branch = np.zeros(len(beside), int)
    points = Points(at.points.at + np.stack(beside) * scale, at.points[first_branch].modes)
    images = problem[first_branch].evaluated(points, at.parameter[first_branch])
    jacobians = images.jacobian * scale / scale[:, None]
    if not (images.sound.all() and np.isfinite(jacobians).all()):
        return float("nan")
    pairs = list(zip(jacobians[::2], jacobians[1::2], strict=True))
    first = [(ahead - behind) / (2.0 * BESIDE) for ahead, behind in pairs]
    second = [(ahead - 2.0 * J + behind) / BESIDE**2 for ahead, behind in pairs]
    if kind == "neimark_sacker":
        return neimark_sacker_coefficient(J, q, p, multiplier, first, second)
    q, p = np.real(q), np.real(p)
    B, C = first[0], second[0]
    quadratic = B @ q
    if kind in ("fold", "transcritical"):
        return float(0.5 * p @ quadratic)
    if kind == "flip":
        return flip_coefficient(J, q, p, B, C)
    bordered = np.block([[J - np.eye(len(J)), q[:, None]], [p[None], np.zeros((1, 1))]])
    h = np.linalg.solve(bordered, np.append(quadratic - (p @ quadratic) * q, 0.0))[:-1]
    return float(p @ (C @ q / 6.0 - 0.5 * B @ h))


def flip_coefficient(J: Matrix, q: Vector, p: Vector, first: Matrix, second: Matrix) -> float:
    """The coefficient of a flip, from the first and second derivative of the Jacobian along q; p . q = 1.

    Args:
        J: the Jacobian, (size, size).
        q, p: its right and left critical eigenvectors, (size,).
        first, second: first and second derivative of the Jacobian along q, (size, size).
    """
    inner = np.linalg.solve(np.eye(len(J)) - J, first @ q)
    return float(p @ (second @ q / 6.0 + 0.5 * first @ inner))


def neimark_sacker_coefficient(
    J: Matrix,
    q: ComplexVector,
    p: ComplexVector,
    multiplier: complex,
    first: list[Matrix],
    second: list[Matrix],
) -> float:
    """The coefficient of a Neimark-Sacker bifurcation.

    Args:
        J: the Jacobian, (size, size).
        q, p: its right and left critical eigenvectors, (size,), p . q = 1.
        multiplier: the critical multiplier.
        first, second: first and second derivatives of the Jacobian along the real and the imaginary part of
            q, (size, size) each.
    """
    unit = multiplier / abs(multiplier)
    B, conjugate = first[0] + 1j * first[1], first[0] - 1j * first[1]
    eye = np.eye(len(J))
    cubic = (second[0] + second[1]) @ q
    mixed = 2.0 * B @ np.linalg.solve(eye - J, B @ q.conj())
    double = conjugate @ np.linalg.solve(unit**2 * eye - J, B @ q)
    return float(0.5 * (p @ (cubic + mixed + double) / unit).real)


def doubled_direction(at: BranchPoints) -> Vector:
    """The direction in which the cycle of twice the period leaves a flip of one branch (1,)."""
    return np.real(critical_eigenvectors(at.images.jacobian[0], -1.0).right)
