"""Floquet multipliers: the eigenvalues of a return map's Jacobian at a fixed point."""

from __future__ import annotations

import numpy as np


def multipliers(jacobian: np.ndarray, gradients: np.ndarray | None = None) -> np.ndarray:
    """The Floquet multipliers, in descending order of modulus.

    Args:
        jacobian: of the map at its fixed points, (n, size, size) or (size, size).
        gradients: of constrained quantities, (n, k, size) or (k, size): the multipliers are then those of the
            map restricted to their level set, and k fewer.

    Returns:
        Complex numbers (n, size - k) or (size - k,).
    """
    single = jacobian.ndim == 2
    matrices = jacobian[None] if single else jacobian
    if gradients is not None and gradients.shape[-2]:
        normals = gradients[None] if gradients.ndim == 2 else gradients
        matrices = np.stack([_within(a, g) for a, g in zip(matrices, normals, strict=True)])
    found = np.asarray(np.linalg.eigvals(matrices), complex)
    # of two conjugates the one with the positive imaginary part comes first
    order = np.lexsort((-np.imag(found), -np.round(np.abs(found), 12)), axis=-1)
    found = np.take_along_axis(found, order, axis=-1)
    return found[0] if single else found


def _within(matrix: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """The matrix restricted to the directions normal to all gradients."""
    k = len(gradients)
    basis = np.linalg.svd(gradients)[2][k:].T
    return basis.T @ matrix @ basis


def characteristic_polynomial(zeros: np.ndarray) -> np.ndarray:
    """The coefficients (m + 1,) of the polynomial with these zeros (m,), the highest power first.

    A perturbation splits a defective double multiplier by its square root, but changes the polynomial only by
    its own order.
    """
    return np.real(np.poly(zeros))
