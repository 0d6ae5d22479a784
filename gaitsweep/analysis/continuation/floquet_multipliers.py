"""Floquet multipliers of fixed points, the eigenvalues of the map's Jacobian, their vectors and growth.

The Jacobian of a map at its points is `Map.linearised(...).jacobian` (`engine/poincare/map_derivatives.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

Matrix = Float[np.ndarray, "coordinates coordinates"]
Vector = Float[np.ndarray, " coordinates"]
ComplexVector = Complex[np.ndarray, " coordinates"]
# Turns of an orbit after which deviations that have not decayed count as neutral or growing.
MOST_TURNS = 1000


def multipliers(
    jacobian: Float[np.ndarray, "*points coordinates coordinates"],
    gradients: Float[np.ndarray, "*points constrained coordinates"] | None = None,
) -> Complex[np.ndarray, "*points multipliers"]:
    """The Floquet multipliers, in descending order of modulus.

    Args:
        jacobian: of the map at its n fixed points, (n, size, size), or without `gradients` at one,
            (size, size).
        gradients: of constrained quantities, (n, k, size): the multipliers are then those of the map
            restricted to their level set, and k fewer.

    Returns:
        Complex numbers (n, size - k), or (size,) of one point; NaN where a derivative is not finite.
    """
    if gradients is not None and not len(gradients):
        return np.empty((0, jacobian.shape[-1] - gradients.shape[1]), complex)
    finite = np.asarray(np.isfinite(jacobian).all(axis=(-2, -1)))
    if gradients is not None and gradients.shape[1]:
        finite &= np.isfinite(gradients).all(axis=(-2, -1))
        jacobian, gradients = (np.where(finite[:, None, None], of, 0.0) for of in (jacobian, gradients))
        jacobian = np.stack([_restricted(*of_point) for of_point in zip(jacobian, gradients, strict=True)])
    factors = np.linalg.eigvals(np.where(finite[..., None, None], jacobian, 0.0))
    factors = np.where(finite[..., None], factors, complex(np.nan, np.nan))
    # of two conjugates the one with the positive imaginary part comes first
    order = np.lexsort((-np.imag(factors), -np.round(np.abs(factors), 12)), axis=-1)
    return np.take_along_axis(factors, order, axis=-1)


def critical_multiplier(factors: Complex[np.ndarray, " multipliers"], kind: str) -> complex:
    """The multiplier on the unit circle at a bifurcation, from all of them.

    Args:
        factors: the multipliers.
        kind: flip, neimark_sacker (the complex one nearest to the circle, or 1 if all are real), or another,
            whose multiplier is 1.
    """
    if kind == "flip":
        return -1.0
    if kind != "neimark_sacker":
        return 1.0
    upper = factors[np.imag(factors) > 0.0]
    return complex(upper[np.argmin(np.abs(np.abs(upper) - 1.0))]) if upper.size else 1.0


class CriticalEigenvectors(NamedTuple):
    """An eigenvalue with its right and left eigenvectors, left . right = 1, |right| = 1."""

    eigenvalue: complex
    right: ComplexVector
    left: ComplexVector


def critical_eigenvectors(jacobian: Matrix, near: complex) -> CriticalEigenvectors:
    """The eigenvalue next to a number, with its eigenvectors."""
    factors, right = np.linalg.eig(jacobian)
    nearest = int(np.argmin(np.abs(factors - near)))
    q = right[:, nearest].astype(complex)
    q = q * np.exp(-1j * np.angle(q[np.argmax(np.abs(q))])) / np.linalg.norm(q)
    others, left = np.linalg.eig(jacobian.T)
    p = left[:, int(np.argmin(np.abs(others - factors[nearest])))].astype(complex)
    return CriticalEigenvectors(complex(factors[nearest]), q, p / (p @ q))


def largest_growth(jacobians: Sequence[Matrix]) -> float:
    """The largest factor by which a deviation from an orbit grows from one crossing to any later one.

    It is the largest spectral norm of the products of successive Jacobians, and 1 if all of them are below
    (Trefethen and Embree 2005, Spectra and Pseudospectra, ch. 14). Since norms of products are at most the
    products of norms, it is reached before the product over a number of turns is at most 1.

    Args:
        jacobians: of the map at the crossings of the orbit, in order.

    Returns:
        The factor; NaN where deviations have not decayed after `MOST_TURNS` turns of the orbit.
    """
    largest = 1.0
    period = len(jacobians)
    for first in range(period):
        product = np.eye(len(jacobians[0]))
        for crossing in range(MOST_TURNS * period):
            product = jacobians[(first + crossing) % period] @ product
            if not np.isfinite(product).all():
                return float("nan")
            norm = float(np.linalg.norm(product, 2))
            largest = max(largest, norm)
            if (crossing + 1) % period == 0 and norm <= 1.0:
                break
        else:
            return float("nan")
    return largest


def _restricted(
    matrix: Matrix, gradients: Float[np.ndarray, "constrained coordinates"]
) -> Float[np.ndarray, "directions directions"]:
    """The matrix restricted to the directions normal to all gradients."""
    k = len(gradients)
    basis = np.linalg.svd(gradients)[2][k:].T
    return basis.T @ matrix @ basis
