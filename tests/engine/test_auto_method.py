"""`method: auto` of a model without a recommendation: tsit5, and taylor where it is faster."""

from __future__ import annotations

import jax.numpy as jnp
import pytest

from gaitsweep.contract import Model
from gaitsweep.engine.numerics import FINE_TOLERANCE, Numerics
from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.examples.hopper import Hopper
from gaitsweep.examples.lorenz import Lorenz
from gaitsweep.examples.ring_hopper import RingHopper
from gaitsweep.examples.slip_runner import SlipRunner
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged


class Switching(CompassWalker):
    """A walker whose flow switches as its swing leg passes the stance leg."""

    def flow(self, p, s):
        rates = super().flow(p, s)
        return {**rates, "swing_rate": jnp.where(s.swing > s.stance, 1.0, 0.9) * rates["swing_rate"]}


class Dragged(CompassWalker):
    """A walker whose drag by the air has no Taylor series where it is at rest."""

    def flow(self, p, s):
        rates = super().flow(p, s)
        speed = jnp.sqrt(s.swing_rate**2.0 + s.stance_rate**2.0)
        return {**rates, "swing_rate": rates["swing_rate"] - speed * s.swing_rate}


class Squared(CompassWalker):
    """A walker with a whole power."""

    def flow(self, p, s):
        rates = super().flow(p, s)
        return {**rates, "swing_rate": rates["swing_rate"] - s.swing_rate**3.0}


@pytest.mark.parametrize(
    ("model", "method"),
    [
        (CompassWalker(), "taylor"),
        (RingHopper(), "taylor"),
        (Switching(), "tsit5"),  # taylor gains nothing where a flow switches
        (Dragged(), "tsit5"),
        (Squared(), "taylor"),
        (Hopper(), "tsit5"),  # flows of arithmetic alone, which tsit5 evaluates fast
        (SlipRunner(), "tsit5"),
        (Lorenz(), "tsit5"),
        (Multilegged(), "propagator6"),  # as it recommends
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Model) else value,
)
def test_a_fine_tolerance_chooses_taylor_where_it_is_faster(model: Model, method: str) -> None:
    assert Numerics(rtol=FINE_TOLERANCE).resolve(model).method == method
    coarse = Numerics(rtol=10.0 * FINE_TOLERANCE).resolve(model).method
    assert coarse == ("tsit5" if method == "taylor" else method)
    assert Numerics(method="tsit5", rtol=FINE_TOLERANCE).resolve(model).method == "tsit5"
    assert Numerics(rtol=FINE_TOLERANCE, precision="float32").resolve(model).method != "taylor"
