"""Declarations of events in a model's class, the events of a model, and the surfaces on which they happen."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Model
from gaitsweep.dynamics.declarations import Counted, Variable, numbered

if TYPE_CHECKING:
    from gaitsweep.dynamics.declared_model import DeclaredModel


# The signs of an event's function with which it rises through zero in each direction.
_SIGNS = {"rising": (1.0,), "falling": (-1.0,), "both": (1.0, -1.0)}


@dataclasses.dataclass(eq=False)
class Event:
    """A declared event, equal only to itself; see `event`.

    `jump` is the decorator of `effect`, which changes the state, `rest` that of `resting`, by which a body
    comes to rest.
    """

    function: Callable[..., jax.Array]
    name: str
    section: bool | Literal["first"]
    during: Callable[..., Any] | None
    rising: bool
    count: int | str | None = None
    when: Callable[..., Any] | None = None
    signs: tuple[float, ...] = (1.0,)
    effect: Callable[..., Any] | None = None
    resting: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        self.counted = Counted(self.count)

    def singles(self, model: Model) -> tuple[SingleEvent, ...]:
        """The events that it declares for a model, one for each component and direction."""
        places = [None] if self.count is None else list(range(self.counted.size(model)))
        return tuple(SingleEvent(self, place, sign) for place in places for sign in self.signs)

    def jump(self, function: Callable[..., Any], /) -> Event:
        """Decorator of the function (params, state) -> state that the event applies.

        With `count` it is (params, state, i) -> state, where i is the number of the component, from 0.
        """
        if self.effect is not None:
            raise TypeError(f"The event {self.name!r} has two jumps; only one is allowed.")
        self.effect = function
        return self

    def rest(self, function: Callable[..., Any], /) -> Event:
        """Decorator of the function (params, state) -> state by which a body comes to rest after the jump.

        It is applied where the body would be back on a surface within 1e-9 of the nominal period. It sets a
        mode in which the event is not possible (`during`) and `flow` holds the body; another event ends that
        mode.
        """
        if self.resting is not None:
            raise TypeError(f"The event {self.name!r} has two functions of rest; only one is allowed.")
        self.resting = function
        return self


@dataclasses.dataclass(frozen=True)
class SingleEvent:
    """One event of a declaration: of the component `place`, from 0, of an event with `count`.

    It happens where `sign` times the declared function rises through zero.
    """

    declared: Event
    place: int | None = None
    sign: float = 1.0

    @property
    def name(self) -> str:
        """The declared name; with `count`, the component's number, from 1, stands for {} or at its end."""
        return self.declared.name if self.place is None else numbered(self.declared.name, self.place + 1)

    @property
    def guard_names(self) -> tuple[str, ...]:
        """The names of its guards: its crossing, at which it happens, and its return below the surface."""
        return (self.name, self.name) if self.declared.rising else (self.name,)

    @property
    def is_section(self) -> bool:
        """Whether it closes a cycle."""
        section = self.declared.section
        return not self.place if section == "first" else bool(section)

    @property
    def jumps(self) -> bool:
        """Whether the event changes the state."""
        return self.declared.effect is not None

    def height(self, model: Model, params: Any, state: Any) -> Float[Array, ""]:
        """The function of the event: it happens where this rises through zero."""
        height = self._own(self.declared.function(model, params, state))
        return height if self.sign > 0.0 else -height

    def within(self, state: Any) -> Bool[Array, ""]:
        """Whether the modes of a state allow the event."""
        return self._own(True if self.declared.during is None else self.declared.during(state))

    def holds(self, params: Any, state: Any) -> Bool[Array, ""]:
        """Whether its condition holds at a crossing; without it the crossing is passed over."""
        return self._own(True if self.declared.when is None else self.declared.when(params, state))

    def jumped(self, model: Model, params: Any, state: Any) -> Any:
        """The state after its jump."""
        return self._changed(self.declared.effect, model, params, state)

    def rested(self, model: Model, params: Any, state: Any) -> Any:
        """The state in which a body rests after it."""
        return self._changed(self.declared.resting, model, params, state)

    def _own(self, value: Any) -> jax.Array:
        """The component's own value of a declared one (count,), or that of all components."""
        value = jnp.asarray(value)
        return value if self.place is None or value.ndim == 0 else value[self.place]

    def _changed(self, change: Callable[..., Any] | None, model: Model, params: Any, state: Any) -> Any:
        assert change is not None
        return change(model, params, state, *(() if self.place is None else (self.place,)))


def event(
    name: str,
    *,
    count: int | str | None = None,
    section: bool | Literal["first"] = False,
    during: Callable[..., Any] | None = None,
    when: Callable[..., Any] | None = None,
    direction: Literal["rising", "falling", "both"] = "rising",
    rising: bool = True,
) -> Callable[[Callable[..., Float[Array, " ..."]]], Event]:
    """Declare a function (params, state) -> number as the guard of an event.

    The event happens where the function rises through zero. A state on the surface (within the errors of
    rounding and of the location of events) is judged by the flow: one that the flow takes below zero arms the
    event, and one that it takes through zero has just crossed the surface. A start on the surface that moves
    through it has crossed it too, unless the event's jump turns it back: such an impact happens at t = 0.
    Bounces that become too short to be seen end as `event_stall` where they accumulate, or in a state of
    `rest`.

    Events of one instant jump one at a time, in the order of their declaration. One whose function an earlier
    jump has brought below zero does not jump.

    Args:
        name: a few words, such as "foot lands", which also name the event in `stalled_by`.
        count: how many events of this kind there are, one for each foot; as for `parameter`. The function and
            `during` return arrays (count,), and jumps are (params, state, i) -> state. A name with braces,
            "foot {} lands", has the number, from 1, in their place.
        section: whether it closes a cycle; its crossings are the Poincare section. With `count`, "first" is
            that of the first component only.
        during: a function of the state's modes, `lambda state: state.stance`: it happens only while this
            holds, and is armed anew where this begins to hold.
        when: a condition on parameters and variables, `lambda params, state: state.lift < params.clearance`.
            It is judged at the located crossing: where it does not hold, nothing happens there, and the next
            crossing is judged anew.
        direction: whether it happens where the function rises through zero, where it falls, or at both.
        rising: False: it happens where the function is >= 0 while `during` holds, so its jump has to end
            that. Such an event needs no arming, and includes states that are already beyond the surface.

    Raises:
        TypeError: `rising` is False, and there is no `during` that its jump could end, or a `when` or a
            `direction`; or an argument is not among the allowed ones.
    """
    if not rising and during is None:
        raise TypeError(f"The event {name!r} has rising=False, so it needs during=, which its jump ends.")
    if section not in (True, False, "first"):
        raise TypeError(f'The event {name!r} has section={section!r}: allowed are True, False and "first".')
    if direction not in _SIGNS:
        raise TypeError(f"The event {name!r} has direction={direction!r}: allowed are {', '.join(_SIGNS)}.")
    if not rising and (when is not None or direction != "rising"):
        raise TypeError(
            f"The event {name!r} has rising=False, so it has no crossing for when= or direction=: write the "
            "condition into its function, or leave out rising=False."
        )
    return lambda function: Event(function, name, section, during, rising, count, when, _SIGNS[direction])


def instants(
    name: str,
    *,
    every: Callable[[Any], Real[Array, ""] | float] | None = None,
    after: float = 0.0,
    at: Sequence[float] = (),
    section: bool = False,
    during: Callable[..., Any] | None = None,
) -> Any:
    """Declare scheduled instants as an event, which may have a `jump`; the model declares `t = gs.time()`.

    Args:
        name: a few words, as of `event`.
        every: a function of the parameters, the interval (s) between instants. They are whole multiples of it
            after `after`: if a run moves one of these parameters, they are not an interval apart. Declare the
            drive's phase as a variable then, and an event where it is a whole turn.
        after: with `every`, the time (s) of the beginning of the first interval, at whose end is the first
            instant.
        at: times (s) of single instants, instead of `every`; the jump is (params, state, i) -> state with the
            number of the instant, from 0.
        section: whether they close a cycle.
        during: as of `event`.

    Raises:
        TypeError: not exactly one of `every` and `at` is given, `every` is no function, or `after` is given
            without it.

    Example:
        A rotor that is kicked once a second; its section is the standard map:

        >>> import jax.numpy as jnp, gaitsweep as gs
        >>> class Rotor(gs.DeclaredModel):
        ...     strength = gs.parameter("rad/s", "strength of a kick", 0.5)
        ...     t = gs.time()
        ...     angle = gs.variable("rad", "angle", 1.0)
        ...     rate = gs.variable("rad/s", "rate", 0.3)
        ...     kick = gs.instants("kick", every=lambda p: 1.0, section=True)
        ...
        ...     def flow(self, p, s):
        ...         return {"t": 1.0, "angle": s.rate}
        ...
        ...     @kick.jump
        ...     def kicked(self, p, s):
        ...         return s.replace(rate=s.rate + p.strength * jnp.sin(s.angle))
        ...
        ...     def period(self, p):
        ...         return 1.0
        >>> gs.return_map(Rotor())([1.0, 0.3]).round(6).tolist()
        [1.3, 0.781779]
    """
    times = np.atleast_1d(np.asarray(at, float))
    if (every is None) == (not times.size):
        raise TypeError(f"The instants {name!r} need either every= or at=.")
    if every is not None and not callable(every):
        raise TypeError(
            f"The instants {name!r} have every={every!r}, but need a function of the parameters: "
            f"every=lambda p: {every!r}."
        )
    if every is None:
        if after:
            raise TypeError(f"The instants {name!r} have after= without every=: add it to the times of at=.")
        return Event(lambda model, p, s: s.t - times, name, section, during, rising=True, count=len(times))

    def phase(model: Model, params: Any, state: Any) -> Float[Array, ""]:
        return jnp.sin(2.0 * jnp.pi * (state.t - after) / every(params))

    def has_begun(params: Any, state: Any) -> Bool[Array, ""]:
        return state.t > after + 0.5 * every(params)

    return Event(phase, name, section, during, rising=True, when=has_begun)


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
        self._point = {name: getattr(state, name) for name in model.declarations.of_kind(Variable)}
        self._seen: dict[SingleEvent, EventSurface] = {}

    def of(self, event: SingleEvent) -> EventSurface:
        """The surface of an event."""
        if event not in self._seen:
            self._seen[event] = EventSurface.seen_from(
                self._point, lambda x: event.height(self._model, self._params, self._state.replace(**x))
            )
        return self._seen[event]

    def rate(self, event: SingleEvent) -> Float[Array, ""]:
        """The rate of the height of an event's surface along the flow."""
        return self.of(event).rate(flat(self._along))

    def returns_soon(self, event: SingleEvent, unit: Float[Array, ""]) -> Bool[Array, ""]:
        """Whether a state close to the surface of an event meets it again within a small share of a period.

        The height as a parabola, by its rate and acceleration along the flow.
        """

        def rate(point: Any) -> Float[Array, ""]:
            return Surfaces(self._model, self._params, self._state.replace(**point)).rate(event)

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
