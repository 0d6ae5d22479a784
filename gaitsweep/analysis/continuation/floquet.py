"""Floquet multipliers: the eigenvalues of a return map's derivative at a fixed point."""

from __future__ import annotations

import numpy as np


def multipliers(jacobian: np.ndarray, gradients: np.ndarray | None = None) -> np.ndarray:
    """The multipliers, largest in size first.

    Args:
        jacobian: derivative of the map at its fixed points, (n, size, size) or (size, size).
        gradients: of what is held, (n, k, size) or (k, size): the multipliers are then those of the map
            within the surface where it does not change, and k fewer.

    Returns:
        Complex numbers (n, size - k) or (size - k,).
    """
    single = jacobian.ndim == 2
    matrices = jacobian[None] if single else jacobian
    if gradients is not None and gradients.shape[-2]:
        normals = gradients[None] if gradients.ndim == 2 else gradients
        matrices = np.stack([_within(a, g) for a, g in zip(matrices, normals, strict=True)])
    found = np.asarray(np.linalg.eigvals(matrices), complex)
    # conjugates are of one size: the one above the axis comes first
    order = np.lexsort((-np.imag(found), -np.round(np.abs(found), 12)), axis=-1)
    found = np.take_along_axis(found, order, axis=-1)
    return found[0] if single else found


def _within(matrix: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """The matrix on the directions across which no gradient changes."""
    k = len(gradients)
    basis = np.linalg.svd(gradients)[2][k:].T
    return basis.T @ matrix @ basis


def characteristic_polynomial(zeros: np.ndarray) -> np.ndarray:
    """The coefficients (m + 1,) of the polynomial with these zeros (m,), the highest power first.

    A double multiplier whose directions fall together splits by the square root of any perturbation; the
    polynomial moves by no more than the perturbation itself.
    """
    return np.real(np.poly(zeros))
