"""Changes of observables between two results of the same rows, and the sizes by which they are compared."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from gaitsweep.contract import Model, Quantity
from gaitsweep.engine.poincare.maps import wrap_difference
from gaitsweep.engine.recorders.bounds import MIN_SCALE

# The least size of an observable, as a share of its magnitude.
LEAST_SIZE = 1e-2


def circular(model: Model) -> Bool[np.ndarray, " observables"]:
    """Mask of the observables that are angles, (observables,)."""
    return np.array([quantity.circular for quantity in model.observables])


def changes(
    model: Model,
    once: Float[np.ndarray, "*rows observables"],
    again: Float[np.ndarray, "*rows observables"],
) -> Float[np.ndarray, "*rows observables"]:
    """Return the distance of observables (..., observables), that of angles by the shorter way."""
    return np.abs(wrap_difference(once - again, circular(model)))


def sizes(
    quantities: tuple[Quantity, ...], values: Float[np.ndarray, "*rows quantities"]
) -> Float[np.ndarray, " quantities"]:
    """Return the sizes (k,) by which quantities are compared, from their values (..., k).

    They are 1 rad for angles, `Quantity.scale`, or the range of the values, at least `LEAST_SIZE` of their
    magnitude.
    """
    known = np.where(np.isfinite(values), values, np.nan).reshape(-1, len(quantities))
    size = np.full(len(quantities), MIN_SCALE)
    for i, quantity in enumerate(quantities):
        column = known[:, i][~np.isnan(known[:, i])]
        if quantity.circular or quantity.scale is not None:
            size[i] = 1.0 if quantity.scale is None or quantity.circular else quantity.scale
        elif column.size:
            size[i] = max(np.ptp(column), LEAST_SIZE * np.abs(column).max(), MIN_SCALE)
    return size


def counted(model: Model, *values: Float[np.ndarray, "... observables"]) -> Bool[np.ndarray, " observables"]:
    """Mask of the observables (k,) that are counts: whole numbers in all known values (..., k)."""
    whole = ~circular(model)
    for observed in values:
        known = np.where(np.isfinite(observed), observed, 0.0).reshape(-1, whole.size)
        whole &= np.all(known == np.round(known), axis=0)
    return whole
