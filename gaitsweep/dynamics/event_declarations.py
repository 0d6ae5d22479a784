"""Declarations of events in the body of a model's class, and the single events of a model that they make."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Model
from gaitsweep.dynamics.declarations import Counted, numbered

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
        single = self.counted.count is None
        places = [None] if single else list(range(self.counted.size(model)))
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
        name = self.declared.name
        if self.place is None:
            return name
        return numbered(name, self.place + 1)

    @property
    def guard_names(self) -> tuple[str, ...]:
        """The names of its guards: its crossing, and its return below the surface."""
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

    def happens(self, fired: Bool[Array, " guards"]) -> Bool[Array, ""]:
        """Whether it happens, by its guards' flags."""
        return fired[0]


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
    signs = _SIGNS[direction]
    return lambda function: Event(function, name, section, during, rising, count, when, signs)


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
        every: a function of the parameters, the interval (s) between instants.
        after: with `every`, the time (s) of the beginning of the first interval, at whose end is the first
            instant.
        at: times (s) of single instants, instead of `every`; the jump is (params, state, i) -> state with the
            number of the instant, from 0.
        section: whether they close a cycle.
        during: as of `event`.

    Raises:
        TypeError: not exactly one of `every` and `at` is given, or `after` without `every`.

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
    if (every is None) == (not at):
        raise TypeError(f"The instants {name!r} need either every= or at=.")
    if every is None:
        if after:
            raise TypeError(f"The instants {name!r} have after= without every=: add it to the times of at=.")
        times = np.asarray(at, float)
        return Event(lambda model, p, s: s.t - times, name, section, during, rising=True, count=len(times))

    def phase(model: Model, params: Any, state: Any) -> Float[Array, ""]:
        return jnp.sin(2.0 * jnp.pi * (state.t - after) / every(params))

    def has_begun(params: Any, state: Any) -> Bool[Array, ""]:
        return state.t > after + 0.5 * every(params)

    return Event(phase, name, section, during, rising=True, when=has_begun)
