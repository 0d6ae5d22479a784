"""Models by declaration: parameters, variables, modes and events, each written once.

The members that the contract asks for (`parameters`, `initial_conditions`, `observables`, `signals`,
`params`, `init`, `guards`, `jump`, `section`, ...) are built from the declarations. A model may still define
any of them itself.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from gaitsweep.contract import Chart, HybridModel, Model, Quantity
from gaitsweep.dynamics.phase_oscillator import wrapped
from gaitsweep.dynamics.plane_section import Plane
from gaitsweep.near_miss import suggestion

Values = Mapping[str, jax.Array]
Start = float | str
# The fields of a state that say which of its events are armed, and which have turned back at their surface.
ARMED, TURNED = "armed", "turned"


@dataclasses.dataclass(frozen=True)
class _Declaration:
    """A quantity without its name; `count` numbers (`phi_1`, `phi_2`, ...), or a single one where it is None.

    `count` is a number, or the name of a field of the model's structure.
    """

    quantity: Quantity
    count: int | str | None

    def quantities(self, model: Declared, name: str, **changes: Any) -> tuple[Quantity, ...]:
        """The quantities of a field by this name."""
        quantity = dataclasses.replace(self.quantity, name=name, **changes)
        if self.count is None:
            return (quantity,)
        return tuple(
            dataclasses.replace(
                quantity,
                name=f"{name}_{i}",
                meaning=f"{quantity.meaning} {i}",
                symbol=quantity.symbol and f"{quantity.symbol}_{{{i}}}",
            )
            for i in range(1, self.size(model) + 1)
        )

    def size(self, model: Declared) -> int:
        """How many numbers there are, 1 for a single one."""
        return getattr(model, self.count) if isinstance(self.count, str) else self.count or 1

    def shape(self, model: Declared) -> tuple[int, ...]:
        """The shape of the field."""
        return () if self.count is None else (self.size(model),)


@dataclasses.dataclass(frozen=True)
class Parameter(_Declaration):
    """A declared parameter; see `parameter`."""


@dataclasses.dataclass(frozen=True)
class Variable(_Declaration):
    """A declared continuous variable; see `variable`."""

    start: Start | tuple[Start, ...] | None
    observed: bool
    signal: bool

    def starts(self, model: Declared, name: str) -> tuple[Quantity, ...]:
        """The initial conditions, with their defaults; none where a job may not set them."""
        if self.start is None:
            return ()
        found = self.quantities(model, name)
        defaults = self.start if isinstance(self.start, tuple) else (self.start,) * len(found)
        if len(defaults) != len(found):
            raise ValueError(f"{name} has {len(defaults)} start values, but {len(found)} numbers")
        return tuple(
            dataclasses.replace(q, name=f"{q.name}_0", meaning=f"{q.meaning} at the start", default=default)
            for q, default in zip(found, defaults, strict=True)
        )

    def read(self, value: jax.Array, /) -> jax.Array:
        """The value as it is recorded: angles from 0 to 2 pi."""
        return wrapped(value) if self.quantity.circular else value


@dataclasses.dataclass(frozen=True)
class Mode:
    """A declared discrete mode; see `mode`."""

    start: bool | int | tuple[bool | int, ...]
    meaning: str
    count: int | str | None


@dataclasses.dataclass(frozen=True)
class Reading:
    """A declared observable or signal that is computed from the state; see `observable` and `signal`."""

    quantity: Quantity
    function: Callable[..., jax.Array]
    observed: bool
    signal: bool


class Event:
    """A declared event; see `event`. `jump` is the decorator of what the event does to the state."""

    def __init__(
        self,
        function: Callable[..., jax.Array],
        name: str,
        is_section: bool,
        during: Callable[..., Any] | None,
        rising: bool,
    ) -> None:
        self.function, self.name, self.is_section = function, name, is_section
        self.during, self.rising = during, rising
        self.effect: Callable[..., Any] | None = None

    def jump(self, function: Callable[..., Any], /) -> Event:
        """Decorator of the function (params, state) -> state that the event applies."""
        if self.effect is not None:
            raise TypeError(f"The event {self.name!r} has two jumps; write one.")
        self.effect = function
        return self

    @property
    def guard_names(self) -> tuple[str, ...]:
        """The names of its guards."""
        if not self.rising:
            return (self.name,)
        again = (f"{self.name}, without having left",) if self.effect is not None else ()
        return (self.name, f"{self.name}, armed again", *again)

    def within(self, state: Any) -> jax.Array:
        """Whether the modes of a state allow the event."""
        return jnp.asarray(True if self.during is None else self.during(state))


def parameter(
    unit: str,
    meaning: str,
    default: Start | None = None,
    *,
    count: int | str | None = None,
    low: float = -float("inf"),
    high: float = float("inf"),
    open_ends: bool = False,
    circular: bool = False,
    symbol: str = "",
    source: str = "",
) -> Any:
    """Declare a parameter, which the model's functions read as `params.NAME`.

    Args:
        unit, meaning: as jobs, tables and figures show them.
        default: a number, an expression over other parameters ("2*sqrt(kappa)"), or None where a job has to
            give it.
        count: how many there are (`NAME_1`, `NAME_2`, ... in a job, an array (count,) in `params`): a number,
            or the name of a field of the model's structure. None: one scalar.
        low, high, open_ends, circular, symbol, source: as of `Quantity`.
    """
    quantity = Quantity("", unit, meaning, default, low, high, open_ends, circular, symbol, source)
    return Parameter(quantity, count)


def variable(
    unit: str,
    meaning: str,
    start: Start | Sequence[Start] | None = None,
    *,
    count: int | str | None = None,
    low: float = -float("inf"),
    high: float = float("inf"),
    open_ends: bool = False,
    circular: bool = False,
    symbol: str = "",
    scale: float | None = None,
    observed: bool | None = None,
    signal: bool = True,
) -> Any:
    """Declare a continuous variable of the state, which the model's functions read as `state.NAME`.

    Args:
        unit, meaning: as jobs, tables and figures show them.
        start: its default at t = 0, for which jobs have the name `NAME_0`; a number, an expression over
            parameters, or one for each of `count`. None: it starts at 0, or where `complete` puts it.
        count: how many there are, as for `parameter`.
        low, high, open_ends: bounds of the start that a job may set.
        circular: an angle in rad of period 2 pi; it is recorded from 0 to 2 pi.
        symbol, scale: as of `Quantity`.
        observed: whether it is recorded at crossings of the section; by default if it has a start.
        signal: whether traces record it.
    """
    quantity = Quantity("", unit, meaning, None, low, high, open_ends, circular, symbol, "", scale)
    given = start if start is None or isinstance(start, (int, float, str)) else tuple(start)
    return Variable(quantity, count, given, start is not None if observed is None else observed, signal)


def mode(start: bool | int | Sequence[bool | int], meaning: str, *, count: int | str | None = None) -> Any:
    """Declare a discrete mode of the state (a contact, the phase of a step), which only jumps change.

    Args:
        start: its value at t = 0, which decides its type: a bool or an integer, or one for each of `count`.
        meaning: what it says.
        count: how many there are, as for `parameter`.
    """
    return Mode(start if isinstance(start, (bool, int)) else tuple(start), meaning, count)


def observable(
    unit: str,
    meaning: str,
    *,
    circular: bool = False,
    symbol: str = "",
    scale: float | None = None,
    signal: bool = False,
) -> Callable[[Callable[..., jax.Array]], Any]:
    """Declare a function (params, state) -> number as an observable, read at crossings of the section.

    Args:
        unit, meaning: as tables and figures show them.
        circular, symbol, scale: as of `Quantity`.
        signal: whether traces record it too.
    """
    quantity = Quantity("", unit, meaning, circular=circular, symbol=symbol, scale=scale)
    return lambda function: Reading(quantity, function, True, signal)


def signal(
    unit: str, meaning: str, *, circular: bool = False, symbol: str = ""
) -> Callable[[Callable[..., jax.Array]], Any]:
    """Declare a function (params, state) -> number as a signal, which traces record.

    Args:
        unit, meaning: as tables and figures show them.
        circular, symbol: as of `Quantity`.
    """
    quantity = Quantity("", unit, meaning, circular=circular, symbol=symbol)
    return lambda function: Reading(quantity, function, False, True)


def event(
    name: str,
    *,
    section: bool = False,
    during: Callable[..., Any] | None = None,
    rising: bool = True,
) -> Callable[[Callable[..., jax.Array]], Event]:
    """Declare a function (params, state) -> number as the guard of an event.

    The event happens where the function rises through zero. After that it is armed again when the function
    is negative beyond its rounding error, so neither its own jump nor a start on the surface fires it. Where
    its jump has turned the state back, and the function rises beyond its rounding error without having been
    negative, it happens again: bounces too short to be seen end as `event_stall` where they accumulate.
    Several events of one instant apply their jumps in the order of their declaration.

    Args:
        name: what happens, in a few words: "foot lands". Rows that it stalls are told by it.
        section: whether it closes a cycle; its crossings are the Poincare section.
        during: a function of the state's modes, `lambda state: state.stance`: it happens only while this
            holds, and is armed anew where this begins to hold.
        rising: False: it happens wherever the function is >= 0 while `during` holds, so its jump has to end
            that. This needs no arming, and cannot miss what is already beyond the surface.

    Raises:
        TypeError: `rising` is False, and there is no `during` that its jump could end.
    """
    if not rising and during is None:
        raise TypeError(f"The event {name!r} has rising=False, so it needs during=, which its jump ends.")
    return lambda function: Event(function, name, section, during, rising)


def _record(model: type, name: str, fields: Any) -> type:
    """A frozen dataclass of arrays with these fields that JAX knows, as an attribute of the model's class."""
    made = dataclasses.make_dataclass(
        name, [(field, jax.Array) for field in fields], frozen=True, namespace={"replace": _replaced}
    )
    made.__module__, made.__qualname__ = model.__module__, f"{model.__qualname__}.{name}"
    made.__doc__ = f"The {'parameters' if name == 'Params' else 'variables and modes'} of {model.__name__}."
    return jax.tree_util.register_dataclass(made, data_fields=list(fields), meta_fields=[])


def _replaced(self: Any, **changes: Any) -> Any:
    """A copy with some fields replaced, in the types and shapes that they have."""
    fields = vars(self)
    cast = {}
    for name, value in changes.items():
        if name not in fields:
            raise TypeError(f"{type(self).__qualname__} has no field {name}{suggestion(name, fields)}")
        cast[name] = jax.tree.map(_like, fields[name], value)
    return dataclasses.replace(self, **cast)


def _like(old: jax.Array, value: Any) -> jax.Array:
    return jnp.broadcast_to(jnp.asarray(value, old.dtype), old.shape)


_DECLARED = (Parameter, Variable, Mode, Reading, Event)


@dataclasses.dataclass(frozen=True)
class Declared(Model):
    """What declarations give to a model of either family: its quantities, parameters and states.

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
        declared = {**cls.declarations, **{k: v for k, v in vars(cls).items() if isinstance(v, _DECLARED)}}
        # a name that a subclass defines otherwise is no longer declared
        cls.declarations = {k: v for k, v in declared.items() if getattr(cls, k, None) is v}
        if "name" not in vars(cls):
            cls.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        cls._refuse_contradictions()
        cls.Params = _record(cls, "Params", cls._named(Parameter))
        cls.State = _record(cls, "State", [*cls._named(Variable), *cls._named(Mode), *cls._other_fields()])

    @classmethod
    def _other_fields(cls) -> list[str]:
        """Fields of a state that are not declared."""
        return []

    @classmethod
    def _refuse_contradictions(cls) -> None:
        base = next(each for each in cls.__mro__ if getattr(each, "declarations", None) == {})
        for name in cls.declarations:
            if name in ("replace", *cls._other_fields()) or hasattr(base, name):
                raise TypeError(f"{cls.__name__} declares {name}, a name that every model has: rename it.")
        if cls._events() and not any(each.is_section for each in cls._events()):
            raise TypeError(
                f"{cls.__name__} has events but no section: write section=True for the one that ends a cycle."
            )

    @classmethod
    def _named(cls, kind: type) -> dict[str, Any]:
        """The declarations of one kind, by name."""
        return {name: each for name, each in cls.declarations.items() if isinstance(each, kind)}

    @classmethod
    def _events(cls) -> list[Event]:
        # an event whose jump has another name stands in the class twice
        return list(dict.fromkeys(cls._named(Event).values()))

    # what the contract asks for

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return tuple(q for name, each in self._named(Parameter).items() for q in each.quantities(self, name))

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return tuple(q for name, each in self._named(Variable).items() for q in each.starts(self, name))

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return self._recorded("observed")

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self._recorded("signal")

    def params(self, values: Values, /) -> Any:
        fields = {}
        for name, each in self._named(Parameter).items():
            numbers = [jnp.asarray(values[q.name]) for q in each.quantities(self, name)]
            fields[name] = numbers[0] if each.count is None else jnp.stack(numbers)
        return self.Params(**fields)

    def observe(self, params: Any, state: Any, /) -> dict[str, jax.Array]:
        return self._read("observed", params, state)

    def signal(self, params: Any, state: Any, /) -> dict[str, jax.Array]:
        return self._read("signal", params, state)

    def label(self, params: Any, observations: Values, /) -> dict[str, Any]:
        return {"gait": jnp.zeros((), jnp.int32)}

    def failed(self, params: Any, state: Any, /) -> jax.Array:
        return jnp.zeros((), bool)

    # how it is built

    def _started(self, start: Values) -> dict[str, Any]:
        """The declared fields of a state at t = 0."""
        fields: dict[str, Any] = {}
        for name, each in self._named(Variable).items():
            numbers = [jnp.asarray(start[q.name]) for q in each.starts(self, name)]
            if not numbers:
                fields[name] = jnp.zeros(each.shape(self))
            else:
                fields[name] = numbers[0] if each.count is None else jnp.stack(numbers)
        for name, each in self._named(Mode).items():
            count = getattr(self, each.count) if isinstance(each.count, str) else each.count
            value = jnp.asarray(each.start)
            fields[name] = value if count is None else jnp.broadcast_to(value, (count,))
        return fields

    def _recorded(self, kind: str) -> tuple[Quantity, ...]:
        found: list[Quantity] = []
        for name, each in self.declarations.items():
            if isinstance(each, Variable) and getattr(each, kind):
                bounds = {"low": -float("inf"), "high": float("inf"), "open_ends": False}
                found += each.quantities(self, name, **bounds)
            elif isinstance(each, Reading) and getattr(each, kind):
                found.append(dataclasses.replace(each.quantity, name=name))
        return tuple(found)

    def _read(self, kind: str, params: Any, state: Any) -> dict[str, jax.Array]:
        found: dict[str, jax.Array] = {}
        for name, each in self.declarations.items():
            if isinstance(each, Variable) and getattr(each, kind):
                value = each.read(getattr(state, name))
                names = [q.name for q in each.quantities(self, name)]
                found |= {name: value} if each.count is None else dict(zip(names, value, strict=True))
            elif isinstance(each, Reading) and getattr(each, kind):
                found[name] = jnp.asarray(each.function(self, params, state), float)
        return found

    def _flags(self, fired: jax.Array) -> Iterator[tuple[Event, jax.Array]]:
        """Each event with the flags of its guards."""
        first = 0
        for each in self._events():
            last = first + len(each.guard_names)
            yield each, fired[first:last]
            first = last


@dataclasses.dataclass(frozen=True)
class DeclaredModel(Declared, HybridModel):
    """A hybrid model whose class body declares its parameters, variables, modes and events.

    A model derives from it and gives `flow` and `period`; the rest follows from its declarations
    (`parameter`, `variable`, `mode`, `event`, `observable`, `signal`), and may be defined instead. Fields of
    its structure need `@dataclasses.dataclass(frozen=True)`; without such fields no decorator is needed.

    `params` of its functions has the parameters as attributes, `state` the variables and modes;
    `state.replace(NAME=value)` is a state that differs in some of them.
    """

    # Names of the variables that are coordinates of the section, for return maps: those that neither the
    # section nor `complete` fixes, nor a symmetry (position). Empty: all continuous variables.
    section_coordinates: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def _other_fields(cls) -> list[str]:
        return [ARMED, TURNED] if cls._armed() else []

    @classmethod
    def _refuse_contradictions(cls) -> None:
        super()._refuse_contradictions()
        for name in cls.section_coordinates:
            if name not in cls._named(Variable):
                near = suggestion(name, cls._named(Variable))
                raise TypeError(f"{cls.__name__}.section_coordinates has {name}, no variable{near}")

    @classmethod
    def _armed(cls) -> list[Event]:
        """The events that are armed by their function's sign."""
        return [each for each in cls._events() if each.rising]

    def init(self, params: Any, start: Values, /) -> Any:
        fields = self._started(start)
        armed = self._armed()
        if armed:
            fields[ARMED] = fields[TURNED] = jnp.zeros(len(armed), bool)
        state = self.complete(params, self.State(**fields))
        if not armed:
            return state
        planes = [self._plane(each, params, state) for each in armed]
        turned = [self._turns(each, params, state) for each in armed]
        return state.replace(
            armed=jnp.stack([plane.armed_at(x) for plane, x in planes]), turned=jnp.stack(turned)
        )

    def complete(self, params: Any, state: Any, /) -> Any:
        """The state with those variables set that follow from the others, at t = 0 and on the section.

        A model with `section_coordinates` sets here what the section fixes, such as the swing leg of a
        walker whose feet are both on the ground.
        """
        return state

    def guards(self, params: Any, state: Any, /) -> jax.Array:
        found: list[jax.Array] = []
        places = iter(range(len(self._armed())))
        for each in self._events():
            if each.rising:
                plane, x = self._plane(each, params, state)
                place = next(places)
                armed = state.armed[place]
                values = [*plane.guards(x, armed)]
                if each.effect is not None:
                    # a body whose bounces have become too small to be seen would fall through the ground
                    values.append(jnp.where(state.turned[place] & ~armed, plane.above(x), -1.0))
            else:
                values = [jnp.asarray(each.function(self, params, state))]
            found += [jnp.where(each.within(state), value, -1.0) for value in values]
        return jnp.stack(found) if found else jnp.zeros((0,))

    @property
    def guard_names(self) -> tuple[str, ...]:
        return tuple(name for each in self._events() for name in each.guard_names)

    def jump(self, params: Any, state: Any, fired: jax.Array, /) -> Any:
        before = state
        for each, flags in self._flags(fired):
            if each.effect is not None:
                after = each.effect(self, params, state)
                happens = _happens(flags)
                state = jax.tree.map(lambda new, old, f=happens: jnp.where(f, new, old), after, state)
        armed: list[jax.Array] = []
        turned: list[jax.Array] = []
        for each, flags in self._flags(fired):
            if not each.rising:
                continue
            turns = self._turns(each, params, state)
            turned.append(jnp.where(_happens(flags), turns, before.turned[len(armed)]))
            still = Plane.armed_after(before.armed[len(armed)], flags)
            if each.during is not None:
                plane, x = self._plane(each, params, state)
                begins = each.within(state) & ~each.within(before)
                still = jnp.where(begins, plane.armed_at(x), still)
            armed.append(still)
        return state.replace(armed=jnp.stack(armed), turned=jnp.stack(turned)) if armed else state

    def section(self, params: Any, before: Any, fired: jax.Array, /) -> jax.Array:
        closed = jnp.zeros((), bool)
        for each, flags in self._flags(fired):
            if each.is_section:
                closed = closed | _happens(flags)
        return closed

    def chart(self) -> Chart | None:
        return _SectionCoordinates(self) if self.section_coordinates else None

    def _turns(self, event: Event, params: Any, state: Any) -> jax.Array:
        """Whether a state on an event's surface does not go on through it."""
        if event.effect is None:
            return jnp.zeros((), bool)
        plane, x = self._plane(event, params, state)
        at = {name: getattr(state, name) for name in self._named(Variable)}
        rates = self.flow(params, state)
        along = {name: jnp.asarray(rates.get(name, jnp.zeros_like(held)), float) for name, held in at.items()}
        _, rate = jax.jvp(lambda x: event.function(self, params, state.replace(**x)), (at,), (along,))
        return (plane.above(x) <= 0.0) & (rate <= 0.0)

    def _plane(self, armed: Event, params: Any, state: Any) -> tuple[Plane, jax.Array]:
        """An event's surface as a plane, exact at the state's point, and that point (n,).

        The plane says how large the terms of the function are, and so what rounding may do to its sign.
        """
        x = {name: getattr(state, name) for name in self._named(Variable)}
        value, slope = jax.value_and_grad(lambda x: armed.function(self, params, state.replace(**x)))(x)
        at, normal = (jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(t)]) for t in (x, slope))
        return Plane(normal, jnp.sum(normal * at) - value), at


def _happens(flags: jax.Array) -> jax.Array:
    """Whether an event happens, by its guards: its surface is crossed, or met without having been left."""
    return flags[0] | flags[2] if flags.shape[0] == 3 else flags[0]


@dataclasses.dataclass(frozen=True)
class _SectionCoordinates(Chart):
    """The chart of `section_coordinates`: the variables themselves."""

    model: DeclaredModel

    @property
    def coordinates(self) -> tuple[Quantity, ...]:
        return tuple(q for name, each in self._variables() for q in each.quantities(self.model, name))

    def read(self, params: Any, state: Any, /) -> jax.Array:
        return jnp.concatenate(
            [jnp.ravel(each.read(getattr(state, name))) for name, each in self._variables()]
        )

    def place(self, params: Any, at: jax.Array, modes: Any, /) -> Any:
        fields, first = {}, 0
        for name, each in self._variables():
            last = first + each.size(self.model)
            fields[name] = at[first:last].reshape(each.shape(self.model))
            first = last
        return self.model.complete(params, modes.replace(**fields))

    def _variables(self) -> list[tuple[str, Variable]]:
        return [(name, self.model.declarations[name]) for name in self.model.section_coordinates]
