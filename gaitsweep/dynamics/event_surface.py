"""The surfaces on which events happen in one direction, as seen from one state."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.dynamics.declarations import Variable
from gaitsweep.dynamics.event_declarations import SingleEvent

if TYPE_CHECKING:
    from gaitsweep.dynamics.declared_model import DeclaredModel

# Multiple of the rounding error of a height within which a point counts as on the surface.
_RESOLUTIONS = 16.0
# Times (in nominal periods) by which an event may be located late: at least, at most where the height at its
# jump is that of a crossing, and at most where its jump is applied at the crossing itself. The band of a
# surface is the change of its height in `_BAND` such times.
_LATE = 1.0e-12
_LATEST = 1.0e-6
CORRECTED = 1.0e-11
_BAND = 8.0
# Crossings in succession, each without having been below 0, beyond which bounces have accumulated.
_MOST_RETURNS = 2
# A body rests where it would return to a surface within this share of the nominal period.
_RESTING = 1.0e-9


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Arming:
    """The mode of one event: whether it is armed, and from which height on it happens.

    `armed`: it happens where the height rises through `level`. The level is 0, except for a state that a
    jump has left on the surface, or within rounding of it: it is then above the state, so that the residue of
    the last location fires nothing, and a body whose bounces have become too small to be seen does not fall
    through. A level below 0 makes the event happen at once. Not `armed`: the event is armed where the height
    falls below the level, 0 or less. `returns` is the number of crossings in succession without having been
    below 0.
    """

    armed: jax.Array
    level: jax.Array
    returns: jax.Array

    @property
    def accumulated(self) -> Bool[Array, ""]:
        """Whether bounces have become too short to be seen: the event happens without end."""
        return self.returns > _MOST_RETURNS


@dataclasses.dataclass(frozen=True)
class EventSurface:
    """The surface where a function of the state, the height, is zero; it is crossed where the height rises.

    A state is on the surface if its height is zero within its rounding error and within the error of the
    location of events. What happens there follows from the flow: a state that the flow takes below arms the
    event; one that it takes through the surface has crossed it.

    `height` is the function at the state, `rounding` the error of this number, `normal` (n,) its gradient.
    """

    height: Float[Array, ""]
    rounding: Float[Array, ""]
    normal: Float[Array, " numbers"]

    @classmethod
    def seen_from(cls, point: Any, function: Callable[[Any], Float[Array, ""]]) -> EventSurface:
        """The surface of a function of points that are pytrees of n numbers, seen from a point.

        The tangent plane gives the size of the function's terms, and so the rounding error of its sign.
        """
        height, gradient = jax.value_and_grad(function)(point)
        normal = flat(gradient)
        terms = normal * flat(point)
        size = jnp.sum(jnp.abs(terms)) + jnp.abs(jnp.sum(terms) - height)
        # the smallest float: if all terms are zero, the point is on the surface
        rounding = _RESOLUTIONS * jnp.finfo(size.dtype).eps * size + jnp.finfo(size.dtype).tiny
        return cls(height, jax.lax.stop_gradient(rounding), normal)

    def guards(self, mode: Arming) -> Float[Array, " guards"]:
        """The guards (2,): the crossing while armed, else the return below the surface."""
        above = jnp.where(mode.armed, 0.0, mode.level) - self.height - self.rounding
        returned = jnp.where(mode.armed & (mode.level <= 0.0), -1.0, above)
        crossing = jnp.where(mode.armed, self.height - mode.level, -1.0)
        return jnp.stack([jnp.where(mode.accumulated, 1.0, crossing), returned])

    def rate(self, rates: Float[Array, " numbers"]) -> Float[Array, ""]:
        """The time derivative of the height at the rates (n,) of a point."""
        return jnp.sum(self.normal * rates)

    def late(self, rate: Float[Array, ""], unit: Float[Array, ""]) -> Float[Array, ""]:
        """The time (s) since the crossing; 0 where a jump, not the flow, has brought the state above.

        Args:
            rate: the time derivative of the height.
            unit: the nominal period (s).
        """
        passed = jnp.where(rate > 0.0, self.height, 0.0) / jnp.where(rate > 0.0, rate, 1.0)
        return jnp.where(passed <= _LATEST * unit, passed, 0.0)

    def band(
        self, late: Float[Array, ""], unit: Float[Array, ""], *rates: Float[Array, ""]
    ) -> Float[Array, ""]:
        """The largest height of a state that counts as on the surface after a jump.

        Args:
            late: the time (s) by which the jump was late.
            unit: the nominal period (s).
            rates: the time derivatives of the height before and after the jump.
        """
        change = sum(jnp.abs(rate) for rate in rates)
        return self.rounding + _BAND * jnp.maximum(late, _LATE * unit) * change

    def begun(self, band: Float[Array, ""], rate: Float[Array, ""], turned: Bool[Array, ""] | bool) -> Arming:
        """The mode of an event that begins to be possible at this state.

        On the surface, a state that the flow takes through it has just crossed it, except where the jump of
        the event would turn it back: an impact happens at once.

        Args:
            band: the largest height of a state that counts as on the surface.
            rate: the time derivative of the height.
            turned: whether the jump of the event would turn the state back.
        """
        below = self.height < -self.rounding
        on = ~below & (self.height <= band)
        leaves = on & (rate <= 0.0)
        strikes = on & (rate > 0.0) & turned
        least = jnp.minimum(self.height, 0.0)
        level = jnp.where(leaves, self._beyond, jnp.where(strikes | ~below, least, 0.0))
        returns = jnp.zeros((), jnp.int32)
        return Arming(below | leaves | strikes, jax.lax.stop_gradient(level), returns)

    def jumped(
        self,
        mode: Arming,
        crossed: Bool[Array, ""],
        returned: Bool[Array, ""],
        band: Float[Array, ""],
        rate: Float[Array, ""],
        impact: Bool[Array, ""],
    ) -> Arming:
        """The mode after a jump, from that before it.

        Args:
            mode: the mode before the jump.
            crossed, returned: whether the guards of this event have fired.
            band: see `band`.
            rate: that of the height after the jump.
            impact: whether the event has changed the state by a jump of its own, so that a state without a
                rate stays on the surface.
        """
        # a state that has not left the surface since its last crossing is above it by the residues since then
        on = (self.height >= -band) & (self.height <= band + jnp.maximum(mode.level, 0.0))
        leaves = on & jnp.where(impact, rate <= 0.0, rate < 0.0)
        stays = self.height >= -self.rounding
        # a crossing ends the armed state, unless the jump has taken the state below or turned it back
        armed = jnp.where(crossed, leaves | (self.height < -band), mode.armed | leaves)
        least = jnp.where(crossed, jnp.minimum(self.height, 0.0), mode.level)
        level = jnp.where(leaves & stays, self._beyond, jnp.where(armed & crossed, 0.0, least))
        again = jnp.where(mode.armed & (mode.level > 0.0), mode.returns + 1, 0)
        returns = jnp.where(crossed, again, mode.returns)
        new = Arming(
            armed | returned,
            jax.lax.stop_gradient(jnp.where(returned, 0.0, level)),
            jnp.where(returned, 0, returns).astype(mode.returns.dtype),
        )
        return jax.tree.map(lambda old, value: jnp.where(mode.accumulated, old, value), mode, new)

    @property
    def _beyond(self) -> Float[Array, ""]:
        """A level above the state by two units in the last place."""
        above = jnp.maximum(self.rounding * (2.0 / _RESOLUTIONS), jnp.finfo(self.rounding.dtype).tiny)
        return jnp.maximum(self.height, 0.0) + above


class Surfaces:
    """The surfaces of armed events seen from one state, and how their heights change along its flow.

    Args:
        model, params: the model and its parameters.
        state: the state.
    """

    def __init__(self, model: DeclaredModel, params: Any, state: Any) -> None:
        self._model = model
        self._params = params
        self._state = state
        names = (
            name for name, declaration in model.declarations.items() if isinstance(declaration, Variable)
        )
        self._point = {name: getattr(state, name) for name in names}
        self._seen: dict[SingleEvent, EventSurface] = {}

    def of(self, event: SingleEvent) -> EventSurface:
        """The surface of an event."""
        if event not in self._seen:
            model = self._model
            params = self._params
            state = self._state
            self._seen[event] = EventSurface.seen_from(
                self._point, lambda x: event.height(model, params, state.replace(**x))
            )
        return self._seen[event]

    def rate(self, event: SingleEvent) -> Float[Array, ""]:
        """The rate of the height of an event's surface along the flow."""
        return self.of(event).rate(flat(self._along))

    def returns_soon(self, event: SingleEvent, unit: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether a state close to the surface of an event meets it again within a small share of a period.

        The height as a parabola, by its rate and acceleration along the flow.
        """
        model = self._model
        params = self._params
        state = self._state

        def rate(point: Any) -> Float[Array, ""]:
            return Surfaces(model, params, state.replace(**point)).rate(event)

        speed, acceleration = jax.jvp(rate, (self._point,), (self._along,))
        height = self.of(event).height
        time = _RESTING * unit
        near = jnp.abs(height) <= acceleration * time**2 + self.of(event).rounding
        return near & (acceleration > 0.0) & (2.0 * jnp.abs(speed) <= acceleration * time)

    @functools.cached_property
    def _along(self) -> dict[str, jax.Array]:
        """The rates of the variables, 0 for those that the flow does not move."""
        rates = self._model.flow(self._params, self._state)
        return {
            name: jnp.broadcast_to(jnp.asarray(rates.get(name, 0.0), x.dtype), x.shape)
            for name, x in self._point.items()
        }


def flat(point: Any) -> Float[Array, " numbers"]:
    """The numbers of a pytree in one array (n,)."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(point)])
