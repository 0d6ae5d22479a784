"""Models by declaration: parameters, variables, modes and events, each written once.

The members that the contract asks for (`parameters`, `initial_conditions`, `observables`, `signals`,
`params`, `init`, `guards`, `jump`, `section`, ...) are built from the declarations. A model may still define
any of them itself.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Chart, HybridModel, Model, Quantity
from gaitsweep.dynamics.declarations import (
    Event,
    Mode,
    Parameter,
    Reading,
    SingleEvent,
    Symmetry,
    Time,
    Variable,
    faults_of_quantity,
)
from gaitsweep.dynamics.event_surface import CORRECTED, Arming, EventSurface, flat
from gaitsweep.dynamics.footfalls import Footfalls
from gaitsweep.expression import RESERVED
from gaitsweep.near_miss import suggestion
from gaitsweep.run_columns import COLUMNS
from gaitsweep.skeleton import LimbLook

Values = Mapping[str, jax.Array]
# Those of traces, where signals have columns of their own names.
OF_TRACES = ("row", "t", "pass", "status", "stalled_by", "gait")
# The field of a state that says which of its events are armed (`Arming`, an array (events,) in each field).
ARMING = "arming"
# That of the last steps of its feet (`Steps`).
STEPS = "steps"
# A body rests where it would return to a surface within this share of the nominal period.
_RESTING = 1.0e-9


def _record(model: type, name: str, fields: Any) -> type:
    """A frozen dataclass of arrays with these fields that JAX knows, as an attribute of the model's class."""
    record = dataclasses.make_dataclass(
        name,
        [(field, jax.Array) for field in fields],
        frozen=True,
        namespace={"replace": _replaced, "__getattr__": _unknown},
    )
    record.__module__, record.__qualname__ = model.__module__, f"{model.__qualname__}.{name}"
    record.__doc__ = f"The {'parameters' if name == 'Params' else 'variables and modes'} of {model.__name__}."
    return jax.tree_util.register_dataclass(record, data_fields=list(fields), meta_fields=[])


def _replaced(self: Any, **changes: Any) -> Any:
    """A copy with some fields replaced, in the types and shapes that they have."""
    fields = vars(self)
    cast = {}
    for name, value in changes.items():
        if name not in fields:
            raise TypeError(f"{type(self).__qualname__} has no field {name}{suggestion(name, fields)}")
        cast[name] = jax.tree.map(_like, fields[name], value)
    return dataclasses.replace(self, **cast)


def _unknown(self: Any, name: str) -> Any:
    """Refuse a field that a record does not have; Python calls this for no other."""
    if name.startswith("__"):  # libraries ask for their own protocols
        raise AttributeError(name)
    fields = [field.name for field in dataclasses.fields(self)]
    raise AttributeError(f"{type(self).__qualname__} has no field {name}{suggestion(name, fields)}")


def _like(old: jax.Array, value: Any) -> jax.Array:
    return jnp.broadcast_to(jnp.asarray(value, old.dtype), old.shape)


_DECLARED = (Parameter, Variable, Mode, Reading, Event, Symmetry, Footfalls)


@dataclasses.dataclass(frozen=True)
class Declared(Model):
    """Quantities, parameters and states that declarations give to a model of either family.

    The members of the contract that are built here are optional: a model may define any of them itself.

    Raises:
        TypeError: two declarations exclude each other; the message names them.
    """

    source: ClassVar[str] = ""
    gaits: ClassVar[tuple[str, ...]] = ("none",)
    declarations: ClassVar[Mapping[str, Any]] = {}
    Params: ClassVar[type]
    State: ClassVar[type]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        declared = {**cls._inherited(), **{k: v for k, v in vars(cls).items() if isinstance(v, _DECLARED)}}
        # a name that a subclass defines otherwise is no longer declared
        cls.declarations = {k: v for k, v in declared.items() if getattr(cls, k, None) is v}
        if "name" not in vars(cls):
            cls.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        cls._refuse_contradictions()
        if (feet := cls._feet()) is not None and cls.gaits is Declared.gaits:
            cls.gaits = feet.gaits
        cls.Params = _record(cls, "Params", [*cls._named(Parameter), *cls._other_parameters()])
        more = cls._added_fields()
        cls.State = _record(cls, "State", [*cls._named(Variable), *cls._named(Mode), *more])

    @classmethod
    def _inherited(cls) -> dict[str, Any]:
        """The declarations of the bases, less the events that this class replaces.

        An event whose jump has another name is an attribute of the class under both; its name is the first.
        """
        first: dict[Event, str] = {}
        inherited = dict(cls.declarations)
        for name, declaration in cls.declarations.items():
            if not isinstance(declaration, Event) or first.setdefault(declaration, name) == name:
                continue
            if getattr(cls, first[declaration], None) is not declaration:
                del inherited[name]
            elif getattr(cls, name, None) is not declaration:
                raise TypeError(
                    f"{cls.__name__} defines {name}, the name of the jump of {first[declaration]} in its "
                    f"base: declare the event {first[declaration]} again, with its jump."
                )
        return inherited

    @classmethod
    def _other_parameters(cls) -> list[str]:
        """Fields of the parameters that are not declared."""
        return []

    @classmethod
    @abc.abstractmethod
    def _other_fields(cls) -> list[str]:
        """Fields of a state that are not declared."""

    @classmethod
    def _added_fields(cls) -> list[str]:
        return [*cls._other_fields(), *([STEPS] if cls._feet() is not None else [])]

    @classmethod
    def _feet(cls) -> Footfalls | None:
        """The declared footfalls; None: there are none."""
        return next(iter(cls._named(Footfalls).values()), None)

    @abc.abstractmethod
    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        """Whether a state lies beyond the surface of an event."""

    @classmethod
    def _refuse_contradictions(cls) -> None:
        # the base that this package gives; its own declarations are no names of the user's
        base = next(base for base in cls.__mro__[1:] if base.__module__.startswith("gaitsweep.dynamics."))
        for name in cls.declarations:
            if getattr(base, "declarations", {}).get(name) is cls.declarations[name]:
                continue
            if name in ("replace", *cls._added_fields()) or hasattr(base, name):
                raise TypeError(f"{cls.__name__} declares {name}, a name that every model has: rename it.")
        if (events := cls.declared_events()) and not any(event.section for event in events):
            remedy = "write section=True for the one that ends a cycle"
            raise TypeError(f"{cls.__name__} has events but no section: {remedy}.")
        feet, variables = cls._feet(), cls._named(Variable)
        if feet is not None and feet.clock not in variables:
            near = suggestion(feet.clock, variables)
            raise TypeError(f"{cls.__name__} has footfalls of the clock {feet.clock}, no variable{near}")
        if feet is not None and cls.gaits not in (Declared.gaits, feet.gaits) and cls.label is Declared.label:
            remedy = f"leave gaits out, which then are {', '.join(feet.gaits)}, or write label"
            raise TypeError(f"{cls.__name__} has footfalls and gaits of its own without label: {remedy}.")
        sizes = cls._default_sizes()
        counts = {
            name: declared.count
            for name, declared in cls.declarations.items()
            if not isinstance(declared, Symmetry) and isinstance(declared.count, str)
        }
        for name, count in counts.items():
            if count not in sizes and not hasattr(cls, count):
                field = f"a field of its structure{suggestion(count, sizes) if sizes else ': it has none.'}"
                raise TypeError(f'{cls.__name__} declares {name} with count="{count}", which is not {field}')
        if all(isinstance(sizes.get(count), int) for count in counts.values()):
            for wrong in cls._faults(sizes):
                raise TypeError(f"{cls.__name__} is a model {wrong}")

    @classmethod
    def _default_sizes(cls) -> dict[str, Any]:
        """The fields of the structure with their defaults; the class is no dataclass yet."""
        hints = {k: v for base in reversed(cls.__mro__) for k, v in inspect.get_annotations(base).items()}
        values = {k: getattr(cls, k, None) for k, hint in hints.items() if "ClassVar" not in str(hint)}
        return {k: v.default if isinstance(v, dataclasses.Field) else v for k, v in values.items()}

    @classmethod
    def _faults(cls, sizes: Mapping[str, Any]) -> Iterator[str]:
        """Faults of names, units, bounds and defaults that the declarations alone show, as ends of sentences.

        Args:
            sizes: the fields of the structure by name.
        """
        # an instance cannot be made of a class that is not complete
        model = SimpleNamespace(**sizes, _named=cls._named, _recorded=cls._recorded, _feet=cls._feet)
        names = ("parameters", "initial_conditions", "signals", "observables")
        parameters, starts, signals, observables = (vars(Declared)[name].fget(model) for name in names)
        settable = [q.name for q in (*parameters, *starts)]
        for name in settable:
            if name in RESERVED:
                remedy = f'write {name}_, or another name with symbol="{name}"'
                yield f"with a quantity {name}, which means something else in formulas: {remedy}."
            if settable.count(name) > 1:
                yield f"that declares {name} twice: rename one of them."
        # a table has the signals, or the observables with an end, and those alone along a branch
        columns = {q.name: (q.name, COLUMNS) for q in (*parameters, *starts)}
        columns |= {q.name: (q.name, OF_TRACES) for q in signals}
        columns |= {f"{q.name}{end}": (q.name, COLUMNS) for q in observables for end in ("", "_end", "_n")}
        for column, (name, others) in columns.items():
            if column in others or (column in settable and column != name):
                remedy = f'write {name}_, or another name with symbol="{name}"'
                names = "docs/own_model.md lists the names of columns"
                yield f"with a quantity {name}, but tables have a column {column}: {remedy}. {names}."
        for quantity in (*parameters, *starts, *signals, *observables):
            yield from faults_of_quantity(quantity, quantity in starts)

    @classmethod
    def _named(cls, kind: type) -> dict[str, Any]:
        """The declarations of one kind, by name."""
        return {
            name: declaration
            for name, declaration in cls.declarations.items()
            if isinstance(declaration, kind)
        }

    @classmethod
    def declared_events(cls) -> list[Event]:
        """The declared events, each once."""
        # an event whose jump has another name is in the class twice
        return list(dict.fromkeys(cls._named(Event).values()))

    def single_events(self) -> list[SingleEvent]:
        """The declared events, one for each component and direction."""
        return [single for event in self.declared_events() for single in event.singles(self)]

    # what the contract asks for

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return tuple(
            q for name, parameter in self._named(Parameter).items() for q in parameter.quantities(self, name)
        )

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        declared = {**self._named(Variable), **self._named(Mode)}
        return tuple(q for name, declaration in declared.items() for q in declaration.starts(self, name))

    @property
    def observables(self) -> tuple[Quantity, ...]:
        recorded, feet = self._recorded("observed"), self._feet()
        declared = (q for name, declaration in recorded.items() for q in declaration.recorded(self, name))
        return (*declared, *(feet.observables if feet is not None else ()))

    @property
    def signals(self) -> tuple[Quantity, ...]:
        recorded, feet = self._recorded("signal"), self._feet()
        declared = (q for name, declaration in recorded.items() for q in declaration.recorded(self, name))
        return (*declared, *(feet.signals if feet is not None else ()))

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        feet = self._feet()
        return feet.limbs if feet is not None else ()

    def section_variables(self) -> list[tuple[str, Variable]]:
        """The variables that are coordinates of the section, by name; clocks are none."""
        variables, feet = self._named(Variable), self._feet()
        clocks = {name for name, variable in variables.items() if isinstance(variable, Time)}
        clocks |= set() if feet is None else {feet.clock}
        return [(name, variable) for name, variable in variables.items() if name not in clocks]

    def begun_on_section(self, params: Any, state: Any) -> Any:
        """A state on the section, just behind its crossing, with its events armed."""
        return state

    def params(self, values: Values, /) -> Any:
        return self.Params(**self._gathered(values))

    def _gathered(self, values: Values) -> dict[str, Any]:
        """The declared fields of the parameters."""
        fields = {}
        for name, parameter in self._named(Parameter).items():
            fields[name] = parameter.gathered(
                [jnp.asarray(values[q.name]) for q in parameter.quantities(self, name)]
            )
        return fields

    def observe(self, params: Any, state: Any, /) -> dict[str, Real[Array, ""]]:
        read, feet = self._read("observed", params, state), self._feet()
        return read if feet is None else read | feet.observed(self, params, state, state.steps)

    def signal(self, params: Any, state: Any, /) -> dict[str, Real[Array, ""]]:
        read, feet = self._read("signal", params, state), self._feet()
        if feet is None:
            return read
        down = feet.down(self, params, state).astype(float)
        return read | dict(zip([q.name for q in feet.signals], down, strict=True))

    def label(self, params: Any, observations: Values, /) -> dict[str, Any]:
        feet = self._feet()
        return {"gait": jnp.zeros((), jnp.int32) if feet is None else feet.gait(observations)}

    def failed(self, params: Any, state: Any, /) -> Bool[Array, ""]:
        return jnp.zeros((), bool)

    def beyond_at_start(self, params: Any, state: Any, /) -> dict[str, Bool[Array, ""]]:
        return {
            event.name: event.within(state)
            & event.holds(params, state)
            & self._is_beyond(event, params, state)
            for event in self.single_events()
            if event.declared.rising and event.jumps
        }

    # how it is built

    def _started(self, start: Values) -> dict[str, Any]:
        """The declared fields of a state at t = 0."""
        fields: dict[str, Any] = {}
        for name, declaration in self._named(Variable).items():
            numbers = [jnp.asarray(start[q.name]) for q in declaration.starts(self, name)]
            fields[name] = declaration.gathered(numbers) if numbers else jnp.zeros(declaration.shape(self))
        for name, declaration in self._named(Mode).items():
            fields[name] = declaration.at_start(
                self, [start.get(q.name, q.default) for q in declaration.starts(self, name)]
            )
        if (feet := self._feet()) is not None:
            fields[STEPS] = feet.begun(fields[feet.clock])
        return fields

    def _stepped(self, params: Any, before: Any, after: Any, reset: Float[Array, ""] | None = None) -> Any:
        """The state `after` a jump with the steps of its feet; `reset`: by which (s) its clock was set.

        By default that is the whole change of the clock.
        """
        if (feet := self._feet()) is None:
            return after
        if reset is None:
            reset = jnp.asarray(getattr(after, feet.clock) - getattr(before, feet.clock))
        return after.replace(steps=feet.after(self, params, before.steps, before, after, reset))

    @classmethod
    def _recorded(cls, kind: str) -> dict[str, Variable | Reading]:
        """The declarations that are recorded as "observed" or as "signal"."""
        recorded = {**cls._named(Variable), **cls._named(Reading)}
        return {name: recorded[name] for name in cls.declarations if getattr(recorded.get(name), kind, False)}

    def _read(self, kind: str, params: Any, state: Any) -> dict[str, jax.Array]:
        read = (reading.values(self, name, params, state) for name, reading in self._recorded(kind).items())
        return {name: value for values in read for name, value in values.items()}

    def _flags(self, fired: Bool[Array, " events"]) -> Iterator[tuple[SingleEvent, Bool[Array, " guards"]]]:
        """Each event with the flags of its guards."""
        first = 0
        for event in self.single_events():
            last = first + len(event.guard_names)
            yield event, fired[first:last]
            first = last


@dataclasses.dataclass(frozen=True)
class DeclaredModel(Declared, HybridModel):
    """A hybrid model whose class body declares its parameters, variables, modes and events.

    1. A model gives `flow` and `period`, and declares a `parameter`, a `variable` and an `event` that closes
       its cycles (`section=True`). Fields of its structure need `@dataclasses.dataclass(frozen=True)`;
       without such fields no decorator is needed.
    2. It may give further declarations (`mode`, `observable`, `signal`, `energy`) and optional members:
       `source`, `gaits` with `label`, `failed`, `section_coordinates` with `complete`, and those of
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
        return [ARMING] if any(event.rising for event in cls.declared_events()) else []

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name in cls.section_coordinates:
            if name not in cls._named(Variable):
                near = suggestion(name, cls._named(Variable))
                raise TypeError(f"{cls.__name__}.section_coordinates has {name}, no variable{near}")

    def _armed(self) -> list[SingleEvent]:
        """The events that are armed by their function's sign."""
        return [event for event in self.single_events() if event.declared.rising]

    def init(self, params: Any, start: Values, /) -> Any:
        fields = self._started(start)
        events = self._armed()
        if events:
            shape = (len(events),)
            fields[ARMING] = Arming(jnp.zeros(shape, bool), jnp.zeros(shape), jnp.zeros(shape, jnp.int32))
        return self._begun(params, self.complete(params, self.State(**fields)))

    def section_variables(self) -> list[tuple[str, Variable]]:
        variables = self._named(Variable)
        chosen = [(name, variables[name]) for name in self.section_coordinates]
        return chosen or super().section_variables()

    def begun_on_section(self, params: Any, state: Any) -> Any:
        return self._begun(params, state, crossed=True)

    def _begun(self, params: Any, state: Any, *, crossed: bool = False) -> Any:
        """The state with its events armed by where it lies and moves.

        With `crossed`, a state on the surface of a section is just behind its crossing.
        """
        surfaces = _Surfaces(self, params, state)
        unit = self.period(params)
        modes = []
        for event in self._armed():
            surface, rate = surfaces.of(event), surfaces.rate(event)
            turned = False if crossed and event.is_section else self._turned(event, params, state)
            band = surface.band(jnp.zeros(()), unit, rate) if crossed else surface.rounding
            modes.append(surface.begun(band, rate, turned))
        return state.replace(arming=_stacked(modes)) if modes else state

    def _turned(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""] | bool:
        """Whether the jump of an event turns a state on its surface back."""
        if not event.jumps:
            return False
        back = _Surfaces(self, params, event.jumped(self, params, state)).rate(event) <= 0.0
        return back & event.holds(params, state)

    def complete(self, params: Any, state: Any, /) -> Any:
        """The state with those variables set that follow from the others, at t = 0 and on the section.

        A model with `section_coordinates` sets here what the section fixes, such as the swing leg of a
        walker whose feet are both on the ground.
        """
        return state

    def guards(self, params: Any, state: Any, /) -> Float[Array, " guards"]:
        surfaces = _Surfaces(self, params, state)
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
        after, rates = state, {}
        for place, (event, flags) in zip(self._places(), self._flags(fired), strict=True):
            if not event.jumps:
                continue
            happens = event.happens(flags) & event.holds(params, state)
            if place is None:
                after = _where(happens, event.jumped(self, params, after), after)
                continue
            # a body whose bounces have accumulated stays as it is, until its row ends
            happens = happens & ~_at(state.arming, place).accumulated
            applied, rates[event] = self._applied(event, params, after)
            after = _where(happens, applied, after)
        after = self._rearmed(params, state, after, fired, rates) if self._armed() else after
        return self._stepped(params, state, after)

    def _applied(self, event: SingleEvent, params: Any, state: Any) -> tuple[Any, Float[Array, ""]]:
        """The state after the jump of an event that was crossed a little earlier, and its rate there.

        The jump is applied where the surface was crossed, and the time since then is made up for. Otherwise
        a jump that sets a variable would lose that time, and clocks that strike together would come apart.
        """
        surfaces = _Surfaces(self, params, state)
        unit = self.period(params)
        late = jax.lax.stop_gradient(surfaces.of(event).late(surfaces.rate(event), unit))
        late = jnp.where(late <= CORRECTED * unit, late, 0.0)
        after = event.jumped(self, params, self._moved(params, state, -late))
        return self._moved(params, after, late), _Surfaces(self, params, after).rate(event)

    def _moved(self, params: Any, state: Any, time: Float[Array, ""]) -> Any:
        """The state a short time (s) later, along its rates."""
        rates = self.flow(params, state)
        return state.replace(**{name: getattr(state, name) + time * rate for name, rate in rates.items()})

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
        unit = self.period(params)
        was, now = _Surfaces(self, params, before), _Surfaces(self, params, after)
        flags = dict(self._flags(fired))
        events = self._armed()
        late = jnp.max(
            jnp.stack([jnp.where(flags[e][0], was.of(e).late(was.rate(e), unit), 0.0) for e in events])
        )
        modes = []
        for place, event in enumerate(events):
            surface, rate, mode = now.of(event), now.rate(event), _at(before.arming, place)
            band = surface.band(late, unit, was.rate(event), rate)
            crossed, returned = flags[event]
            holds = event.holds(params, before)
            rate = jnp.where(crossed & holds, rates.get(event, rate), rate)
            new = surface.jumped(mode, crossed, returned, band, rate, holds & event.jumps)
            if event.declared.during is not None:
                begins = event.within(after) & ~event.within(before)
                new = _where(begins, surface.begun(band, rate, self._turned(event, params, after)), new)
            modes.append(new)
        arming = _stacked(modes)
        after = after.replace(arming=arming)
        resting = [event for event in self.single_events() if event.declared.resting is not None]
        if not resting:
            return after
        # a state that an event with a jump would meet again within no time
        soon = [
            event.within(after) & event.holds(params, after) & arming.armed[k] & now.returns_soon(event, unit)
            for k, event in enumerate(events)
            if event.jumps
        ]
        comes_to_rest = jnp.any(jnp.stack(soon)) | jnp.any(arming.accumulated)
        for event in resting:
            rests = event.happens(flags[event]) & event.holds(params, before) & comes_to_rest
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
        return {
            event: event.happens(flags) & event.holds(params, before) for event, flags in self._flags(fired)
        }

    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        passed = ~_at(state.arming, self._armed().index(event)).armed
        if not (event.is_section and self.section_coordinates):
            return passed
        # coordinates of the section describe states just after its event, which are on its surface
        surface = _Surfaces(self, params, state).of(event)
        return passed & (surface.height > surface.rounding)

    def energies(self, params: Any, state: Any, /) -> dict[str, Float[Array, ""]]:
        readings = self._named(Reading)
        return {
            name: reading.function(self, params, state)
            for name, reading in readings.items()
            if reading.is_energy
        }

    def symmetries(self) -> Mapping[str, Callable[[Any, Any], Any]]:
        def image(declared: Symmetry) -> Callable[[Any, Any], Any]:
            # events are armed by where the image lies and moves
            return lambda params, state: self._begun(params, declared.function(self, params, state))

        return {name: image(declared) for name, declared in self._named(Symmetry).items()}

    def chart(self) -> Chart | None:
        return SectionCoordinates(self)


class _Surfaces:
    """The surfaces of armed events seen from one state, and how their heights change along its flow."""

    def __init__(self, model: DeclaredModel, params: Any, state: Any) -> None:
        self._model, self._params, self._state = model, params, state
        names = (
            name for name, declaration in model.declarations.items() if isinstance(declaration, Variable)
        )
        self._point = {name: getattr(state, name) for name in names}
        self._seen: dict[SingleEvent, EventSurface] = {}

    def of(self, event: SingleEvent) -> EventSurface:
        """The surface of an event."""
        if event not in self._seen:
            model, params, state = self._model, self._params, self._state
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
        model, params, state = self._model, self._params, self._state

        def rate(point: Any) -> Float[Array, ""]:
            return _Surfaces(model, params, state.replace(**point)).rate(event)

        speed, acceleration = jax.jvp(rate, (self._point,), (self._along,))
        height, time = self.of(event).height, _RESTING * unit
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


def _where(condition: Bool[Array, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _at(armed: Arming, place: int) -> Arming:
    return jax.tree.map(lambda leaf: leaf[place], armed)


def _stacked(modes: list[Arming]) -> Arming:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *modes)


@dataclasses.dataclass(frozen=True)
class SectionCoordinates(Chart):
    """The chart of `section_coordinates`, the variables themselves; of all variables where there are none.

    Args:
        model: a `DeclaredModel`, or a map without events (`map_model`).
    """

    model: Any

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(
            q
            for name, variable in self.model.section_variables()
            for q in variable.quantities(self.model, name)
        )

    def to_coordinates(self, params: Any, state: Any, /) -> Float[Array, " coordinates"]:
        return jnp.concatenate(
            [
                jnp.ravel(variable.read(getattr(state, name)))
                for name, variable in self.model.section_variables()
            ]
        )

    def from_coordinates(self, params: Any, at: Float[Array, " coordinates"], modes: Any, /) -> Any:
        fields, first = {}, 0
        for name, variable in self.model.section_variables():
            last = first + variable.size(self.model)
            value = at[first:last].reshape(variable.shape(self.model))
            if variable.quantity.circular:
                # coordinates are angles from 0 to 2 pi, but a phase that waits for its event may be beyond
                own = getattr(modes, name)
                value = value + (own - variable.read(own))
            fields[name] = value
            first = last
        state = self.model.complete(params, modes.replace(**fields))
        return self.model.begun_on_section(params, state)

    @property
    def conserved(self) -> tuple[Quantity, ...]:
        return tuple(q for name, energy in self._energies() for q in energy.quantities(self.model, name))

    def conserved_values(
        self, params: Any, at: Float[Array, " coordinates"], /
    ) -> Float[Array, " conserved"]:
        if not (energies := self._energies()):
            return jnp.zeros((0,))
        # the modes of a state on the section are those of a start
        starts = {q.name: jnp.asarray(q.default, jnp.float64) for q in self.model.initial_conditions}
        state = self.from_coordinates(params, at, self.model.init(params, starts))
        return jnp.stack([energy.function(self.model, params, state) for _, energy in energies])

    def _energies(self) -> list[tuple[str, Reading]]:
        readings = self.model._named(Reading)
        return [(name, reading) for name, reading in readings.items() if reading.is_conserved]
