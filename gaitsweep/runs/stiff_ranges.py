"""Ends of the ranges of a model's parameters at which its flow is stiff."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from gaitsweep.contract import HybridModel
from gaitsweep.engine.flow_spectrum import STIFF, fastest_rates

# A flow is stiff if its fastest rate times the nominal period is above `STIFF`; an end of a range is reported
# if that is also above `STIFFER` times its value at the defaults.
STIFFER = 10.0


def stiff_ranges(model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]]) -> list[str]:
    """Return sentences about defaults, and ends of a parameter's range, with which the flow is stiff.

    The range is that of the bounds, or of the values tried. Modes that are no flags have their values at the
    start.
    """
    defaults = {name: float(column[0]) for name, column in values.items()}
    ends: list[tuple[str, float]] = []
    for quantity in model.parameters:
        tried = values[quantity.name]
        for bound, end_of_tried in ((quantity.low, np.min(tried)), (quantity.high, np.max(tried))):
            is_bounded = math.isfinite(bound) and not quantity.open_ends
            ends.append((quantity.name, bound if is_bounded else float(end_of_tried)))
    rate_at_defaults, *rates = _fastest_rates(model, [defaults, *({**defaults, name: x} for name, x in ends)])
    if math.isnan(rate_at_defaults.per_second):
        return ["At the defaults a derivative of the flow is infinite or NaN, so its stiffness is unknown."]
    sentences = []
    if rate_at_defaults.per_period > STIFF:
        sentences.append(f"At the defaults the flow is stiff: its {rate_at_defaults}.")
    for (name, end), rate in zip(ends, rates, strict=True):
        if rate.per_period > max(STIFF, STIFFER * rate_at_defaults.per_period):
            sentences.append(
                f"{name} = {end:.4g}, far from its default {defaults[name]:.4g}, makes the flow stiff: "
                f"its {rate}. Bounds (low=, high=) keep rows from there."
            )
    return sentences


@dataclasses.dataclass(frozen=True)
class _FastestRate:
    """The fastest rate (1/s) of a flow, and that per nominal period."""

    per_second: float
    per_period: float

    def __str__(self) -> str:
        return (
            f"fastest rate is {self.per_second:.2g} 1/s, and a cycle takes about {self.per_period:.2g} steps"
        )


def _fastest_rates(model: HybridModel, rows: Sequence[Mapping[str, float]]) -> list[_FastestRate]:
    """The fastest rate of the flow at the start of each row with these parameters and starts.

    It is NaN where a derivative of the flow is infinite or NaN.
    """
    of_rows = {name: np.array([row[name] for row in rows], float) for name in rows[0]}
    values = {q.name: of_rows[q.name] for q in model.parameters}
    starts = {q.name: of_rows[q.name] for q in model.initial_conditions}
    rates, periods = fastest_rates(model, values, starts)
    return [
        _FastestRate(float(rate), float(rate * period)) for rate, period in zip(rates, periods, strict=True)
    ]
