"""Sliding along a surface where a flow switches, such as sticking friction, as a mode of a declared model.

A. F. Filippov, Differential equations with discontinuous righthand sides, 1988: where the flows of both sides
point to the surface, the state slides along it, with the mean of both flows that keeps it there.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.dynamics.event_declarations import Event
from gaitsweep.dynamics.noise import along_rates

if TYPE_CHECKING:
    from gaitsweep.dynamics.declared_model import DeclaredModel

Height = Callable[[Any, Any], Float[Array, ""]]


@dataclasses.dataclass(frozen=True, eq=False)
class Sliding:
    """A declared surface of sliding; see `sliding`.

    Its mode is 1 above the surface, -1 below it, and 0 while the state slides. `name` is that of the mode.
    """

    meaning: str
    height: Height
    static: Callable[[Any], Any]
    name: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", name)

    @functools.cached_property
    def events(self) -> tuple[Event, Event]:
        """The events that a state meets the surface, and that it leaves it."""
        meets = Event(
            lambda model, p, s: -getattr(s, self.name) * self.height(p, s),
            f"{self.meaning}: meets",
            section=False,
            during=lambda s: getattr(s, self.name) != 0,
            rising=True,
            effect=self._met,
        )
        leaves = Event(
            lambda model, p, s: jnp.abs(_balance(*self._sides(model, p, s))) - self._held_up_to(p),
            f"{self.meaning}: leaves",
            section=False,
            during=lambda s: getattr(s, self.name) == 0,
            rising=True,
            effect=self._left,
        )
        return meets, leaves

    def flow(self, function: Callable[..., Any], /) -> Callable[..., Any]:
        """Decorator of the model's `flow`, which reads this mode as 1 or -1."""

        @functools.wraps(function)
        def flow(model: DeclaredModel, params: Any, state: Any) -> dict[str, Any]:
            above = function(model, params, state.replace(**{self.name: 1}))
            below = function(model, params, state.replace(**{self.name: -1}))
            mode = getattr(state, self.name)
            balance = _balance(self._rate(params, state, above), self._rate(params, state, below))
            share = 0.5 * (1.0 + jnp.where(mode == 0, balance, mode))
            return {name: share * above[name] + (1.0 - share) * below[name] for name in above}

        flow.sliding = self  # type: ignore[attr-defined]
        return flow

    def _sides(self, model: DeclaredModel, params: Any, state: Any) -> tuple[Float[Array, ""], ...]:
        """The rates of the height by the flows above and below."""
        flows = (model.flow(params, state.replace(**{self.name: side})) for side in (1, -1))
        return tuple(self._rate(params, state, rates) for rates in flows)

    def _holds(self, params: Any, above: Float[Array, ""], below: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether a state on the surface stays there, with these rates of the height."""
        return (above < below) & (jnp.abs(_balance(above, below)) <= self._held_up_to(params))

    def begun(self, model: DeclaredModel, params: Any, state: Any, rounding: Float[Array, ""]) -> Any:
        """The state with the mode that follows from where it lies; `rounding` is the error of the height.

        A state that slides is put on the surface, as the flows of both sides would do within no time. So it
        is there, too, that derivatives lead by small displacements off the surface.
        """
        height = self.height(params, state)
        flows = [model.flow(params, state.replace(**{self.name: side})) for side in (1, -1)]
        above, below = (self._rate(params, state, rates) for rates in flows)
        slides = self._holds(params, above, below)
        leaves = jnp.where(above > 0.0, 1, -1)
        side = jnp.where(height > 0.0, 1, -1)
        at_surface = jnp.where(slides, 0, leaves)
        mode = jnp.where(jnp.abs(height) <= rounding, at_surface, side)
        across = {name: flows[0][name] - flows[1][name] for name in flows[0]}
        back = jnp.where(mode == 0, -height / jnp.where(slides, above - below, 1.0), 0.0)
        return along_rates(state, across, back).replace(**{self.name: mode})

    def _rate(self, params: Any, state: Any, rates: Any) -> Float[Array, ""]:
        """The time derivative of the height at some rates."""

        def later(time: Float[Array, ""]) -> Float[Array, ""]:
            moved = {name: getattr(state, name) + time * rate for name, rate in rates.items()}
            return self.height(params, state.replace(**moved))

        return jax.jvp(later, (jnp.zeros(()),), (jnp.ones(()),))[1]

    def _held_up_to(self, params: Any) -> Float[Array, ""]:
        """The static friction as a multiple of the kinetic one, which is at least 1."""
        return jnp.maximum(jnp.asarray(self.static(params), float), 1.0)

    def _met(self, model: DeclaredModel, params: Any, state: Any) -> Any:
        """The state that slides, goes through the surface, or has only touched it."""
        above, below = self._sides(model, params, state)
        slides = self._holds(params, above, below)
        mode = getattr(state, self.name)
        leaves_behind = jnp.where(mode > 0, below < 0.0, above > 0.0)
        return state.replace(**{self.name: jnp.where(slides, 0, jnp.where(leaves_behind, -mode, mode))})

    def _left(self, model: DeclaredModel, params: Any, state: Any) -> Any:
        """The state on the side to which the flow takes it."""
        side = jnp.where(_balance(*self._sides(model, params, state)) > 0.0, 1, -1)
        return state.replace(**{self.name: side})


def _balance(above: Float[Array, ""], below: Float[Array, ""]) -> Float[Array, ""]:
    """The mean of 1 and -1 whose weights make that of the rates above and below zero."""
    difference = above - below
    return -(above + below) / jnp.where(difference == 0.0, 1.0, difference)


def sliding(meaning: str, height: Height, *, static: Callable[[Any], Any] | None = None) -> Any:
    """Declare a surface on which the flow switches, and along which states may slide.

    The attribute's name is a mode that `flow` reads as 1 above the surface and -1 below it. `flow` has the
    decorator `@NAME.flow`. A state that meets the surface goes through it, or slides along it, with the mean
    of both flows that stays on the surface (Filippov 1988), until that mean is one of both flows.

    Args:
        meaning: a few words, as of `event`, such as "block sticks".
        height: a function (params, state) of the variables, above 0 on the one side of the surface: of a
            block on a belt, its speed relative to the belt.
        static: a function of the parameters, the static friction as a multiple of the kinetic one; by
            default, and where it is below 1, they are equal. It holds for forces that are proportional to the
            mode.

    A state that slides keeps the height to rounding where the height is linear in the variables, and else to
    the tolerance of the steps.

    Example:
        A block on a spring, on ground with friction, starts 2.5 m from the spring's rest. Each half swing
        loses 2 mu m g/k = 0.4 m of the amplitude, and the block stops where the spring no longer moves it,
        within 0.2 m:

        >>> import jax.numpy as jnp, gaitsweep as gs
        >>> class Block(gs.DeclaredModel):
        ...     friction = gs.parameter("m/s2", "friction over the mass", 0.2)
        ...     x = gs.variable("m", "place", 2.5)
        ...     v = gs.variable("m/s", "speed", 0.0)
        ...     t = gs.time()
        ...     slip = gs.sliding("block sticks", lambda p, s: s.v)
        ...     tick = gs.instants("tick", every=lambda p: 1.0, section=True)
        ...
        ...     @slip.flow
        ...     def flow(self, p, s):
        ...         return {"x": s.v, "v": -s.x - p.friction * s.slip, "t": 1.0}
        ...
        ...     def period(self, p):
        ...         return 1.0
        >>> ends = gs.sweep(Block(), run={"kind": "fixed_time", "duration": 40.0}, friction=[0.2]).table
        >>> ends[["x_end", "v_end"]].round(6).abs().to_numpy().tolist()
        [[0.1, 0.0]]
    """
    return Sliding(meaning, height, static or (lambda params: 1.0))
