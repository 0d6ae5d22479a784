"""Registry of the kinds of measures."""

from __future__ import annotations

from gaitsweep.fitting.measures import (
    Coexistence,
    Edge,
    Failures,
    FixedPoint,
    Measure,
    Order,
    Prominence,
    Share,
    Value,
)
from gaitsweep.fitting.ramp_measures import GaitSequence, Transition
from gaitsweep.schema.strict_model import Registry

MEASURES: Registry[Measure] = Registry(
    "measure",
    [Value, Edge, Share, Coexistence, Order, Prominence, Failures, FixedPoint, Transition, GaitSequence],
)
