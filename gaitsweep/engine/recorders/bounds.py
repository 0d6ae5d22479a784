"""The bounds within which the observables of a settled state stay: their tolerances times their scales."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.angles import wrapped_difference
from gaitsweep.contract import Model
from gaitsweep.engine.carry import Integer, Observed

# Crossings over which a settled state must be constant.
SETTLE_WINDOW = 10
# Largest change of a settled observable in a crossing, as a share of its scale.
TOLERANCE = 1.0e-3
# The smallest scale of an observable without a scale of its own, as a share of its magnitude: integration
# errors and rounding are relative to that.
MIN_RELATIVE_SCALE = 1.0e-5
# The smallest scale of such an observable in its unit, so that an observable at 0 settles.
MIN_SCALE = 1.0e-9
# The largest change of an observable in its unit that may be rounding where the section keeps it at 0: that
# is relative to its values between crossings, which are not known here.
ROUNDING = 1.0e-5 * MIN_SCALE
# Differences of the observables between a crossing and those before it, or their values at these.
Crossings = Float[Array, "crossings observables"]
# The least and the largest value of each observable without a scale.
Span = Float[Array, "2 unscaled"]


def tolerances(model: Model, tolerance: float | Mapping[str, float]) -> float | tuple[float, ...]:
    """The tolerance of each observable in order.

    Args:
        model: the model.
        tolerance: one for all observables, which is returned, or those of some by name; others have
            `TOLERANCE`. Run kinds refuse a name that is no observable.
    """
    if not isinstance(tolerance, Mapping):
        return tolerance
    return tuple(tolerance.get(quantity.name, TOLERANCE) for quantity in model.observables)


def per_observable(tolerance: float | tuple[float, ...]) -> tuple[float, ...]:
    """The tolerances of the observables as a tuple, which has one number if it is that of all."""
    return tolerance if isinstance(tolerance, tuple) else (tolerance,)


def unscaled(model: Model) -> list[int]:
    """The places of the observables without a scale of their own."""
    return [i for i, q in enumerate(model.observables) if not q.circular and q.scale is None]


def first_span(model: Model, like: Observed) -> Span:
    """The span (2, n) of the observables without a scale before the first crossing: (inf, -inf).

    Args:
        model: the model.
        like: observables, whose dtype the span has.
    """
    none = jnp.full((len(unscaled(model)),), jnp.inf, like.dtype)
    return jnp.stack([none, -none])


def widened(span: Span, model: Model, now: Observed) -> Span:
    """The span (2, n) with one more crossing; NaN and infinities are left out.

    Args:
        span: the least and largest values so far.
        model: the model.
        now: the observables (k,) of the crossing.
    """
    if span.size == 0:
        return span
    values = now[np.asarray(unscaled(model))]
    finite = jnp.abs(values) < jnp.inf
    lowest = jnp.where(finite & (values < span[0]), values, span[0])
    return jnp.stack([lowest, jnp.where(finite & (values > span[1]), values, span[1])])


def bounds(model: Model, tolerance: float | tuple[float, ...], latest: Crossings, span: Span) -> Observed:
    """The largest change of each observable (n,) of a settled state over the window, in its unit; above 0.

    It is `SETTLE_WINDOW` times its tolerance times its scale: 1 rad for angles, `Quantity.scale` if defined,
    else the range of its values over the row, from their `span`. That scale is at least `MIN_RELATIVE_SCALE`
    of the magnitude at the `latest` crossings (w, n), and `MIN_SCALE`.

    Args:
        model: the model.
        tolerance: one for all observables, or one for each.
        latest: the observables at the latest crossings (w, n).
        span: the least and largest values of the observables without a scale, from `widened`.
    """
    tolerance_of_each = per_observable(tolerance)
    if len(tolerance_of_each) == 1:
        tolerance_of_each = tolerance_of_each * len(model.observables)
    share = jnp.asarray([SETTLE_WINDOW * number for number in tolerance_of_each], latest.dtype)
    declared = [1.0 if q.circular else q.scale for q in model.observables]
    scales = jnp.asarray([0.0 if scale is None else scale for scale in declared], latest.dtype)
    places = np.asarray(unscaled(model), np.int64)
    if places.size == 0:
        return share * scales
    smallest = MIN_RELATIVE_SCALE * jnp.max(jnp.abs(latest[:, places]), axis=0)
    of_span = jnp.maximum(jnp.maximum(span[1] - span[0], smallest), MIN_SCALE)
    return share * scales.at[places].set(of_span)


def slowest(moved: Crossings) -> Integer:
    """The place of the observable with the largest change (w, n), in units of its bound; -1 if unknown."""
    largest = jnp.max(moved, axis=0)
    return jnp.where(jnp.any(jnp.isnan(largest)), -1, jnp.argmax(largest))


def comparable(observed: Float[Array, "*crossings observables"]) -> Float[Array, "*crossings observables"]:
    """Observables for comparison: one without a value (NaN), such as the lag of a standing foot, is 0."""
    return jnp.where(jnp.isnan(observed), 0.0, observed)


def change(model: Model, difference: Crossings) -> Crossings:
    """Differences of observables; differences of angles are wrapped to [-pi, pi)."""
    circular = jnp.asarray([q.circular for q in model.observables])
    return jnp.where(circular[None, :], wrapped_difference(difference), difference)
