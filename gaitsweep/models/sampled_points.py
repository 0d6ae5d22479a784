"""Random points over the ranges of a model's parameters and starts, at which its functions are tried."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from jaxtyping import Float

from gaitsweep.contract import Model, Quantity
from gaitsweep.expression import in_order, resolve

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_WIDE_BOUNDS = 100.0  # times the reach about a default: bounds that are further apart only clip it
MAX_NAMED = 8  # values that a sentence about a point names

Columns = Mapping[str, Float[np.ndarray, " rows"]]


def sampled_points(model: Model, n: int) -> tuple[Columns, Columns]:
    """Parameters and starts (n,) by name: the defaults, then random points over their ranges.

    Whole numbers, such as seeds, and starts without a default have the same value at all points. A range is
    that between a quantity's bounds. Where these are far apart or missing, a parameter goes from half to
    twice its default, and a start by three times its default (by 3 where that is 0) to both sides.

    Raises:
        ExpressionError: a default has no value.
    """
    random = np.random.default_rng(0)
    sizes: dict[str, Any] = {
        field.name: float(size)
        for field in fields_of(type(model))
        if isinstance(size := getattr(model, field.name), int | float)
    }

    def drawn(
        quantities: Sequence[Quantity], numbers_before: Mapping[str, Any], *, is_start: bool
    ) -> Columns:
        formulas = {q.name: q.default for q in quantities if isinstance(q.default, str)}
        numbers = {
            q.name: _values_in_range(random, n, q, is_start=is_start)
            for q in quantities
            if q.name not in formulas
        }
        resolved = resolve(in_order(formulas), {**numbers_before, **numbers})
        return {q.name: np.broadcast_to(np.asarray(resolved[q.name], float), (n,)) for q in quantities}

    parameters = drawn(model.parameters, sizes, is_start=False)
    return parameters, drawn(model.initial_conditions, {**sizes, **parameters}, is_start=True)


def _values_in_range(
    random: np.random.Generator, n: int, quantity: Quantity, *, is_start: bool
) -> Float[np.ndarray, " rows"]:
    """The default of a quantity, then n - 1 random values in its range."""
    default = _typical_value(quantity)
    if math.isnan(default) or quantity.whole:  # a start that the model itself decides, or a mode
        return np.full(n, default)
    reach = 3.0 * (abs(default) or 1.0)
    if is_start:
        low = default - reach
        high = default + reach
    else:
        low, high = sorted((0.5 * default, 2.0 * default))
    if quantity.high - quantity.low < _WIDE_BOUNDS * reach:
        low = quantity.low
        high = quantity.high
    within = random.uniform(max(low, quantity.low), min(high, quantity.high), n - 1)
    return np.append(default, within)


def written(values: Columns, row: int) -> str:
    """The values of a row that differ from the first: " at w = 2, x_0 = 2.4"; the first has the defaults."""
    differ = [f"{name} = {column[row]:.6g}" for name, column in values.items() if column[row] != column[0]]
    if not differ:
        return " at the model's defaults"
    return " at " + ", ".join(differ[:MAX_NAMED]) + (", ..." if len(differ) > MAX_NAMED else "")


def _typical_value(quantity: Quantity) -> float:
    """The default of a quantity that is a number; near 1 in its bounds where it has none."""
    assert not isinstance(quantity.default, str)
    if quantity.default is not None:
        return float(quantity.default)
    return float(np.clip(1.0, quantity.low, quantity.high))


def fields_of(model_class: type[Model]) -> tuple[dataclasses.Field[Any], ...]:
    """The fields of a class of models, which is a dataclass although `Model` itself is none."""
    return dataclasses.fields(cast("type[DataclassInstance]", model_class))
