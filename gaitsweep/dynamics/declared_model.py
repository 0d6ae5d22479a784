"""Models by declaration: parameters, variables, modes and events, each written once.

The members that the contract asks for (`parameters`, `initial_conditions`, `observables`, `signals`,
`params`, `init`, `guards`, `jump`, `section`, ...) are built from the declarations. A model may still define
any of them itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gaitsweep.contract import Chart, FixedStepDynamics, HybridModel, Model, Recommended
from gaitsweep.dynamics.declarations import Reading, Variable
from gaitsweep.dynamics.declared import Declared, Values
from gaitsweep.dynamics.event_declarations import CORRECTED, Arming, SingleEvent, Surfaces
from gaitsweep.dynamics.noise import StochasticSteps, along_rates
from gaitsweep.dynamics.section_coordinates import SectionCoordinates
from gaitsweep.dynamics.sliding import Sliding
from gaitsweep.near_miss import suggestion

# The field of a state that says which of its events are armed (`Arming`, an array (events,) in each field).
ARMING = "arming"


@dataclasses.dataclass(frozen=True)
class DeclaredModel(Declared, HybridModel):
    """A hybrid model whose class body declares its parameters, variables, modes and events.

    1. A model gives `flow` and `period`, and declares a `parameter`, a `variable` and an `event` that closes
       its cycles (`section=True`). Fields of its structure need `@dataclasses.dataclass(frozen=True)`;
       without such fields no decorator is needed.
    2. It may give further declarations (`mode`, `observable`, `signal`, `energy`, `diffusion`) and optional
       members: `source`, `gaits` with `label`, `failed`, `section_coordinates` with `complete`, and those of
       `HybridModel`.
    3. The engine alone calls the members that are built from the declarations: `parameters`, `params`,
       `init`, `guards`, `jump`, `section`, `observe`, ... A model may define them instead.

    `params` of its functions has the parameters as attributes, `state` the variables and modes;
    `state.replace(NAME=value)` is a state that differs in some of them.

    Example:
        A rimless wheel rolls down a slope on spokes that are 0.6 rad apart. An impact keeps the share
        cos(0.6) of its rate, so the rate of its gait follows from the energy that a step gains (McGeer 1990,
        Int. J. Robotics Research 9:62):

        >>> import jax.numpy as jnp, numpy as np, gaitsweep as gs
        >>> class Wheel(gs.DeclaredModel):
        ...     slope = gs.parameter("rad", "slope of the ground, downwards", 0.08)
        ...     angle = gs.variable("rad", "angle of the spoke on the ground from the vertical")
        ...     rate = gs.variable("1", "rate of the angle, in sqrt(g / l)", 0.5)
        ...
        ...     def complete(self, p, s):
        ...         return s.replace(angle=p.slope - 0.3)
        ...
        ...     def flow(self, p, s):
        ...         return {"angle": s.rate, "rate": jnp.sin(s.angle)}
        ...
        ...     @gs.event("spoke lands", section=True)
        ...     def landing(self, p, s):
        ...         return s.angle - p.slope - 0.3
        ...
        ...     @landing.jump
        ...     def impact(self, p, s):
        ...         return s.replace(angle=p.slope - 0.3, rate=jnp.cos(0.6) * s.rate)
        ...
        ...     def period(self, p):
        ...         return 2.0
        >>> slope = np.array([0.06, 0.08])
        >>> rate = gs.sweep(Wheel(), slope=slope, run=gs.Settle(tolerance=1e-6)).table["rate_end"]
        >>> rate.round(4).tolist()
        [0.3892, 0.4493]
        >>> (2.0 / np.tan(0.6) * np.sqrt(np.sin(0.3) * np.sin(slope))).round(4).tolist()
        [0.3892, 0.4493]
    """

    # Names of the variables that are coordinates of the section, for return maps: those that neither the
    # section nor `complete` fixes, nor a symmetry (position). Empty: all continuous variables.
    section_coordinates: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def _other_fields(cls) -> list[str]:
        return [ARMING] if any(event.rising for event in cls.declarations.events) else []

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        chosen = cls.section_coordinates
        if not isinstance(chosen, tuple | list):
            raise TypeError(
                f"{cls.__name__}.section_coordinates is {chosen!r}, but must be a tuple of names of "
                'variables, such as ("x",), or ().'
            )
        for name in chosen:
            if name not in cls.declarations.of_kind(Variable):
                near = suggestion(name, cls.declarations.of_kind(Variable))
                raise TypeError(f"{cls.__name__}.section_coordinates has {name}, no variable{near}")
        for event in cls.declarations.events:
            if event.resting is not None and event.effect is None:
                raise TypeError(
                    f"{cls.__name__} declares a rest after the event {event.name!r}, which has no jump: "
                    "write the jump, or set the mode of rest in the jump of another event."
                )

    @property
    def locates_events(self) -> bool:
        return self.declarations.diffusion is None

    def fixed_step_scheme(self) -> FixedStepDynamics | None:
        noise = self.declarations.diffusion
        return None if noise is None else StochasticSteps(self, noise)

    @property
    def recommended(self) -> Recommended:
        return Recommended("auto" if self.locates_events else "semi_implicit")

    def _armed(self) -> list[SingleEvent]:
        """The events that are armed by their function's sign."""
        return [event for event in self.single_events() if event.declared.rising]

    def init(self, params: Any, start: Values, /) -> Any:
        fields = self._started(start)
        events = self._armed()
        if events:
            shape = (len(events),)
            fields[ARMING] = Arming(jnp.zeros(shape, bool), jnp.zeros(shape), jnp.zeros(shape, jnp.int32))
        return self._begun(params, self._placed(params, self.State(**fields)))

    def _placed(self, params: Any, state: Any) -> Any:
        """The state at t = 0 from its initial conditions, before modes and events follow from it."""
        return self.complete(params, state)

    def displaced(self, params: Any, state: Any, /) -> Any:
        """The state with the mode of sliding that follows from its variables."""
        for surface in self.declarations.of_kind(Sliding).values():
            meets, _ = surface.events
            # the event's function is the height times the mode, which is 0 where the state slides
            above = state.replace(**{surface.name: 1})
            rounding = Surfaces(self, params, above).of(SingleEvent(meets)).rounding
            state = surface.begun(self, params, state, rounding)
        return state

    def section_variables(self) -> list[tuple[str, Variable]]:
        variables = self.declarations.of_kind(Variable)
        chosen = [(name, variables[name]) for name in self.section_coordinates]
        return chosen or super().section_variables()

    def _begun(self, params: Any, state: Any, *, crossed: bool = False) -> Any:
        """The state with its mode of sliding and its events armed by where it lies and moves.

        With `crossed`, a state on the surface of a section is just behind its crossing.
        """
        state = self.displaced(params, state)
        surfaces = Surfaces(self, params, state)
        period = self.period(params)
        modes = []
        for event in self._armed():
            surface = surfaces.of(event)
            rate = surfaces.rate(event)
            turned = False if crossed and event.is_section else self._turned(event, params, state)
            band = surface.band(jnp.zeros(()), period, rate) if crossed else surface.rounding
            modes.append(surface.begun(band, rate, turned))
        return state.replace(arming=_stacked(modes)) if modes else state

    def _turned(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""] | bool:
        """Whether the jump of an event turns a state on its surface back."""
        if not event.jumps:
            return False
        after = Surfaces(self, params, event.jumped(self, params, state))
        return (after.rate(event) <= 0.0) & event.holds(params, state)

    def guards(self, params: Any, state: Any, /) -> Float[Array, " guards"]:
        surfaces = Surfaces(self, params, state)
        guards: list[jax.Array] = []
        for place, event in zip(self._places(), self.single_events(), strict=True):
            if place is None:
                values = [event.height(self, params, state)]
            else:
                values = [*surfaces.of(event).guards(_at(state.arming, place))]
            guards += [jnp.where(event.within(state), value, -1.0) for value in values]
        return jnp.stack(guards) if guards else jnp.zeros((0,))

    def _places(self) -> list[int | None]:
        """The place of each event among those that are armed."""
        armed = self._armed()
        return [armed.index(event) if event.declared.rising else None for event in self.single_events()]

    @property
    def guard_names(self) -> tuple[str, ...]:
        return tuple(name for event in self.single_events() for name in event.guard_names)

    def occurred(self, params: Any, state: Any, fired: Bool[Array, " guards"], /) -> Bool[Array, " guards"]:
        happened: list[Any] = []
        for event, happens in self.happening(params, state, fired).items():
            # a second guard is the return below the surface
            happened += [happens, *[jnp.asarray(False)] * (len(event.guard_names) - 1)]
        return jnp.stack(happened) if happened else fired

    def jump(self, params: Any, state: Any, fired: Bool[Array, " events"], /) -> Any:
        after = state
        rates = {}
        of_sliding = {
            event for surface in self.declarations.of_kind(Sliding).values() for event in surface.events
        }
        displaced = jnp.asarray(False)
        for place, (event, flags) in zip(self._places(), self._flags(fired), strict=True):
            if not event.jumps:
                continue
            happens = flags[0] & event.holds(params, state)
            if place is None:
                after = _where(happens, event.jumped(self, params, after), after)
                displaced = displaced | happens
                continue
            # a body whose bounces have accumulated stays as it is, until its row ends
            happens = happens & ~_at(state.arming, place).accumulated
            applied, rates[event] = self._applied(event, params, after)
            after = _where(happens, applied, after)
            if event.declared not in of_sliding:
                displaced = displaced | happens
        if of_sliding:
            # a jump of another event may take the state off the surface, or onto it
            after = _where(displaced, self.displaced(params, after), after)
        after = self._rearmed(params, state, after, fired, rates) if self._armed() else after
        return self._stepped(params, state, after)

    def _applied(self, event: SingleEvent, params: Any, state: Any) -> tuple[Any, Float[Array, ""]]:
        """The state after the jump of an event that was crossed a little earlier, and its rate there.

        The jump is applied where the surface was crossed, and the time since then is made up for. Otherwise
        a jump that sets a variable would lose that time, and clocks that strike together would come apart.
        """
        surfaces = Surfaces(self, params, state)
        period = self.period(params)
        late = jax.lax.stop_gradient(surfaces.of(event).late(surfaces.rate(event), period))
        late = jnp.where(late <= CORRECTED * period, late, 0.0)
        after = event.jumped(self, params, self._moved(params, state, -late))
        return self._moved(params, after, late), Surfaces(self, params, after).rate(event)

    def _moved(self, params: Any, state: Any, time: Float[Array, ""]) -> Any:
        """The state a short time (s) later, along its rates."""
        return along_rates(state, self.flow(params, state), time)

    def _rearmed(
        self,
        params: Any,
        before: Any,
        after: Any,
        fired: Bool[Array, " events"],
        rates: Mapping[SingleEvent, Float[Array, ""]],
    ) -> Any:
        """The state `after` a jump, with its events armed; a body that would not leave a surface rests.

        `rates` are those of the events' heights just after their own jumps.
        """
        period = self.period(params)
        surfaces_before = Surfaces(self, params, before)
        surfaces_after = Surfaces(self, params, after)
        flags = dict(self._flags(fired))
        late = self._lateness(surfaces_before, flags, period)
        modes = []
        for place, event in enumerate(self._armed()):
            surface = surfaces_after.of(event)
            rate = surfaces_after.rate(event)
            mode = _at(before.arming, place)
            band = surface.band(late, period, surfaces_before.rate(event), rate)
            crossed, returned = flags[event]
            holds = event.holds(params, before)
            rate = jnp.where(crossed & holds, rates.get(event, rate), rate)
            arming = surface.jumped(mode, crossed, returned, band, rate, holds & event.jumps)
            if event.declared.during is not None:
                begins = event.within(after) & ~event.within(before)
                begun = surface.begun(band, rate, self._turned(event, params, after))
                arming = _where(begins, begun, arming)
            modes.append(arming)
        after = after.replace(arming=_stacked(modes))
        return self._rested(params, before, after, surfaces_after, flags)

    def _lateness(
        self,
        surfaces: Surfaces,
        flags: Mapping[SingleEvent, Bool[Array, " guards"]],
        period: Float[Array, ""],
    ) -> Float[Array, ""]:
        """The largest time (s) since a crossing that has fired, from the state before its jump."""
        times = []
        for event in self._armed():
            late = surfaces.of(event).late(surfaces.rate(event), period)
            times.append(jnp.where(flags[event][0], late, 0.0))
        return jnp.max(jnp.stack(times))

    def _rested(
        self,
        params: Any,
        before: Any,
        after: Any,
        surfaces: Surfaces,
        flags: Mapping[SingleEvent, Bool[Array, " guards"]],
    ) -> Any:
        """The state `after` a jump, at rest where it would meet its surface again within no time.

        `surfaces` are those seen from `after`, before it is at rest.
        """
        resting = [event for event in self.single_events() if event.declared.resting is not None]
        if not resting:
            return after
        period = self.period(params)
        arming = after.arming
        meets_again = [  # of each event with a jump: whether the state would meet it within no time
            event.within(after)
            & event.holds(params, after)
            & arming.armed[k]
            & surfaces.returns_soon(event, period)
            for k, event in enumerate(self._armed())
            if event.jumps
        ]
        comes_to_rest = jnp.any(jnp.stack(meets_again)) | jnp.any(arming.accumulated)
        for event in resting:
            rests = flags[event][0] & event.holds(params, before) & comes_to_rest
            after = _where(rests, self._begun(params, event.rested(self, params, after)), after)
        return after

    def section(self, params: Any, before: Any, fired: Bool[Array, " events"], /) -> Bool[Array, ""]:
        closed = jnp.zeros((), bool)
        for event, happens in self.happening(params, before, fired).items():
            if event.is_section:
                closed = closed | happens
        return closed

    def happening(
        self, params: Any, before: Any, fired: Bool[Array, " events"]
    ) -> dict[SingleEvent, Bool[Array, ""]]:
        """Whether each event happens by the flags of its guards, at the state before its jump."""
        return {event: flags[0] & event.holds(params, before) for event, flags in self._flags(fired)}

    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        passed = ~_at(state.arming, self._armed().index(event)).armed
        if not (event.is_section and self.section_coordinates):
            return passed
        # coordinates of the section describe states just after its event, which are on its surface
        surface = Surfaces(self, params, state).of(event)
        return passed & (surface.height > surface.rounding)

    def energies(self, params: Any, state: Any, /) -> dict[str, Float[Array, ""]]:
        readings = self.declarations.of_kind(Reading).items()
        return {
            name: reading.function(self, params, state) for name, reading in readings if reading.is_energy
        }

    def chart(self) -> Chart:
        return SectionCoordinates(self)


def _where(condition: Bool[Array, ""], yes: Any, no: Any) -> Any:
    """One of two pytrees."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _at(modes: Arming, place: int) -> Arming:
    """The mode of one event among those of all."""
    return jax.tree.map(lambda leaf: leaf[place], modes)


def _stacked(modes: list[Arming]) -> Arming:
    """The modes of events in one array each."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *modes)


def surfaces_of(model: Model) -> dict[str, Sliding]:
    """The surfaces of sliding of a model, by name."""
    return model.declarations.of_kind(Sliding) if isinstance(model, DeclaredModel) else {}
