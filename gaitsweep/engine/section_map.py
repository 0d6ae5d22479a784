"""One trajectory from one section crossing to the next: the map whose Jacobian and fixed points matter."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from gaitsweep.contract import Model, Params, State
from gaitsweep.engine.advance import CROSSING, GOING, Numerics, advance, stalled, start
from gaitsweep.engine.record import ATTEMPTS_PER_STEP


def next_crossing(
    model: Model, numerics: Numerics, *, events: bool = False, sensitivities: bool = True
) -> Callable[[Params, State], tuple[jax.Array, State, jax.Array]]:
    """The function `(params, state) -> (t, state, found)` up to the next section crossing.

    `t` is the time that it takes (s), `state` the one just after the crossing's jump, `found` False where
    no crossing came within four nominal periods, or events stalled the trajectory. Forward-mode derivatives
    (`jax.jvp`, `jax.jacfwd`) are right through all events where `sensitivities` is set; the events' own times
    are among them.

    Args:
        model, numerics: what is integrated and how.
        events: stop after the first jump of any kind, not only at the section.
        sensitivities: see `gaitsweep.engine.advance.advance`.
    """
    attempt = advance(model, numerics, sensitivities=sensitivities)

    def run(params: Params, state: State) -> tuple[jax.Array, State, jax.Array]:
        carry = start(model, params, state, stop=4.0 * model.period(params))
        limit = ATTEMPTS_PER_STEP * (carry.stop / numerics.dt + 1000.0)

        def goes_on(carry):
            jumped = events & (carry.chain > 0)
            return (carry.halt == GOING) & ~jumped & ~stalled(carry) & (carry.attempts <= limit)

        carry = jax.lax.while_loop(goes_on, lambda c: attempt(params, c), carry)
        found = (carry.halt == CROSSING) | (events & (carry.chain > 0))
        return carry.t, carry.state, jnp.asarray(found)

    return run
