"""Floquet multipliers of fixed points: the eigenvalues of the map's Jacobian.

The Jacobian of a map at its points is `Map.linearised(...).jacobian` (`engine/poincare/map_derivatives.py`).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float


def multipliers(
    jacobian: Float[np.ndarray, "*points coordinates coordinates"],
    gradients: Float[np.ndarray, "*points constrained coordinates"] | None = None,
) -> Complex[np.ndarray, "*points multipliers"]:
    """The Floquet multipliers, in descending order of modulus.

    Args:
        jacobian: of the map at its n fixed points, (n, size, size), or at one, (size, size).
        gradients: of constrained quantities, (n, k, size): the multipliers are then those of the map
            restricted to their level set, and k fewer.

    Returns:
        Complex numbers (n, size - k), or (size,) of one point.
    """
    if gradients is not None and gradients.shape[1]:
        jacobian = np.stack([_restricted(*of_point) for of_point in zip(jacobian, gradients, strict=True)])
    factors = np.asarray(np.linalg.eigvals(jacobian), complex)
    # of two conjugates the one with the positive imaginary part comes first
    order = np.lexsort((-np.imag(factors), -np.round(np.abs(factors), 12)), axis=-1)
    return np.take_along_axis(factors, order, axis=-1)


def _restricted(
    matrix: Float[np.ndarray, "coordinates coordinates"],
    gradients: Float[np.ndarray, "constrained coordinates"],
) -> Float[np.ndarray, "directions directions"]:
    """The matrix restricted to the directions normal to all gradients."""
    k = len(gradients)
    basis = np.linalg.svd(gradients)[2][k:].T
    return basis.T @ matrix @ basis
