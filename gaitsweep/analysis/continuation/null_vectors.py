"""The null vectors of a matrix that is nearly singular, by a bordered system."""

from __future__ import annotations

from typing import Any

import numpy as np


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
