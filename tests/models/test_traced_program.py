"""The traced program of a user's model: its constants decide it, and it has to be the same each time."""

from __future__ import annotations

import datetime
import random
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.job import Job, JobError
from gaitsweep.models.conformity import fault
from gaitsweep.models.traced_program import traced_program

SCALE = 1.0
TABLE = jnp.linspace(0.0, 1.0, 5)
generator = np.random.default_rng(1)


class Spring(gs.DeclaredModel):
    q = gs.parameter("1/s", "rate", 1.0)
    x = gs.variable("m", "position", 1.0)
    v = gs.variable("m/s", "speed", 0.0)

    def flow(self, p, s):
        return {"x": s.v, "v": -p.q * s.x}

    @gs.event("v rises through 0", section=True)
    def turns(self, p, s):
        return s.v

    @turns.jump
    def pushed(self, p, s):
        return s.replace(v=1.0 * s.v)

    def period(self, p):
        return 6.28 / p.q


@jax.jit
def noise(x: jax.Array) -> jax.Array:
    return x + np.random.uniform()


def shaken(x: jax.Array, _: Any) -> tuple[jax.Array, None]:
    return x + random.random(), None


class RandomFlow(Spring):
    def flow(self, p, s):
        return {"x": s.v, "v": -p.q * generator.normal() * s.x}


class RandomInJit(Spring):
    def flow(self, p, s):
        return {"x": s.v, "v": -noise(s.x)}


class RandomInLoop(Spring):
    def flow(self, p, s):
        return {"x": s.v, "v": -jax.lax.scan(shaken, s.x, None, length=2)[0]}


class ClockInPeriod(Spring):
    def period(self, p):
        return time.time() / p.q


class RandomJump(Spring):
    @gs.event("x falls through 0")
    def lands(self, p, s):
        return -s.x

    @lands.jump
    def bounce(self, p, s):
        return s.replace(v=random.random() * s.v)


class RandomDefault(Spring):
    @property
    def parameters(self):
        return tuple(
            gs.Quantity(q.name, q.unit, q.meaning, default=random.random()) for q in super().parameters
        )


@pytest.mark.parametrize(
    ("model", "function"),
    [
        (RandomFlow, "flow"),
        (RandomInJit, "flow"),
        (RandomInLoop, "flow"),
        (ClockInPeriod, "period"),
        (RandomJump, "jump"),
        (RandomDefault, "parameters"),
    ],
)
def test_randomness_and_clocks_are_refused_by_name(model: type[gs.DeclaredModel], function: str) -> None:
    assert traced_program(model()).varying == function
    assert f"its function {function} " in str(fault(model()))


def test_a_job_of_a_random_model_is_refused() -> None:
    name = f"{__name__}:RandomFlow"
    with pytest.raises(JobError, match="function flow"):
        Job.model_validate({"name": "a", "model": name, "vary": {"q": [1.0, 2.0]}, "run": {"kind": "settle"}})


def test_fixed_keys_and_dates_at_import_are_constants() -> None:
    begun = datetime.datetime.now().timestamp()

    class Fixed(Spring):
        def flow(self, p, s):
            drawn = jax.random.uniform(jax.random.key(1))
            return {"x": s.v, "v": -p.q * s.x * drawn * begun}

    assert traced_program(Fixed()).varying is None
    assert fault(Fixed()) is None


def test_constants_count_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    class Interpolated(Spring):
        gain = 0.1

        def flow(self, p, s):
            return {"x": s.v, "v": -self.gain * jnp.interp(s.x, TABLE, TABLE)}

    def changed() -> set[str]:
        now = traced_program(Interpolated()).digests
        return {name for name in now if now[name] != before[name]}

    before = traced_program(Interpolated()).digests
    monkeypatch.setattr(Interpolated, "gain", np.nextafter(0.1, 1.0))
    # events are armed by the flow too
    assert {"flow"} <= changed() <= {"flow", "init", "jump", "guards"}
    monkeypatch.undo()
    assert changed() == set()
    monkeypatch.setitem(globals(), "TABLE", TABLE.at[3].add(1e-16 * 8))
    assert {"flow"} <= changed() <= {"flow", "init", "jump", "guards"}


def test_the_scale_of_an_observable_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """It decides when a row has settled, and no function has it."""

    class Scaled(Spring):
        @property
        def observables(self):
            return (gs.Quantity("x", "m", "position", scale=SCALE),)

    before = traced_program(Scaled()).digests
    monkeypatch.setitem(globals(), "SCALE", 2.0)
    now = traced_program(Scaled()).digests
    assert {name for name in now if now[name] != before[name]} == {"observables"}


def test_papers_models_are_known_by_their_version() -> None:
    assert traced_program(gs.models.MultileggedReduced(N=3)).digests == {}
