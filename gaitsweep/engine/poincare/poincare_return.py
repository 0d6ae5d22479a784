"""One trajectory on its way from the section to its next crossing."""

from __future__ import annotations

import dataclasses
import enum
from functools import partial
from typing import Self

import jax
import jax.numpy as jnp

from gaitsweep.contract import HybridModel, Model, Params, State
from gaitsweep.engine.advance import CROSSING, FAILED, GOING, Carry, advance, stalled, start
from gaitsweep.engine.numerics import Numerics, step_of
from gaitsweep.engine.poincare.stagewise import Stages, begin, stagewise
from gaitsweep.engine.propose import own_steps
from gaitsweep.engine.recorders.recorder import ATTEMPTS_PER_STEP

# Nominal periods within which a crossing has to come.
LATEST = 4.0


class Way(enum.IntEnum):
    """How the way to the next crossing ended, with a sentence each."""

    crossed = 0, "The section was crossed."
    late = 1, "No crossing came within four nominal periods."
    stalled = 2, "Events followed each other without end."
    lost = 3, "A state variable became NaN or infinite."
    fell = 4, "The model's own test of a fall came true."
    elsewhere = 5, "The section was crossed in a way that its coordinates do not have."

    sentence: str

    def __new__(cls, number: int, sentence: str) -> Self:
        way = int.__new__(cls, number)
        way._value_, way.sentence = number, sentence
        return way


@partial(jax.tree_util.register_dataclass, data_fields=["carry", "stages", "limit"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Aloft:
    """A trajectory on its way: its carry, the `stages` of a step that is worked out one by one (else None),
    and the attempts at its `limit`."""

    carry: Carry
    stages: Stages | None
    limit: jax.Array


class Flight:
    """The functions of such a way, for every engine.

    With located events, derivatives (forward mode) are right through all of them, their times included.
    Where the numerics take steps of fixed length nothing is located, and `differentiable` is False. `share`
    makes steps shorter, and tolerances finer.
    """

    def __init__(self, model: Model, numerics: Numerics, share: float = 1.0) -> None:
        self.model, self.numerics, self.share = model, numerics.of(model), share
        numerics = self.numerics
        self.differentiable = own_steps(numerics.method, model) is None
        if self.differentiable and numerics.method == "rk4":
            assert isinstance(model, HybridModel)
            self._evaluate = stagewise(model, numerics)
        else:
            self._evaluate = None
            self._advance = advance(model, numerics, sensitivities=self.differentiable)

    def begin(self, params: Params, state: State) -> Aloft:
        """The trajectory that starts from a state just after its crossing's jump."""
        # how long steps are changes with the parameters, but no result depends on it
        dt = self.share * jax.lax.stop_gradient(step_of(self.model, self.numerics, params))
        stop = LATEST * self.model.period(params)
        carry = start(self.model, params, state, dt=dt, stop=stop, share=self.share)
        limit = ATTEMPTS_PER_STEP * (carry.stop / dt * self.numerics.steps_in_longest + 1000.0)
        if self._evaluate is None:
            return Aloft(carry, None, limit)
        assert isinstance(self.model, HybridModel)
        return Aloft(*begin(self.model, params, carry), limit)

    def attempt(self, params: Params, aloft: Aloft) -> Aloft:
        """The trajectory an attempt, or a stage of one, later."""
        if self._evaluate is None:
            return dataclasses.replace(aloft, carry=self._advance(params, aloft.carry))
        assert aloft.stages is not None
        return Aloft(*self._evaluate(params, (aloft.carry, aloft.stages)), aloft.limit)

    def ended(self, aloft: Aloft) -> jax.Array:
        """Whether the way is over."""
        carry = aloft.carry
        return (carry.halt != GOING) | stalled(carry) | (carry.attempts > aloft.limit)

    def way(self, aloft: Aloft) -> jax.Array:
        """How it ended, a `Way`."""
        carry = aloft.carry
        numbers = [x for x in jax.tree.leaves(carry.state) if jnp.issubdtype(x.dtype, jnp.floating)]
        sound = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in [carry.t, *numbers]]))
        stuck = stalled(carry) | (carry.attempts > aloft.limit)
        missed = jnp.where(stuck, Way.stalled, jnp.where(carry.halt == FAILED, Way.fell, Way.late))
        way = jnp.where(sound, jnp.where(carry.halt == CROSSING, Way.crossed, missed), Way.lost)
        return way.astype(jnp.int32)
