"""Members of a model that are built from its declarations, for models with a flow and for others.

These are the quantities, parameters and states that the contract asks for, and what is read from them.
"""

from __future__ import annotations

import abc
import dataclasses
import inspect
import re
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.column_meanings import COLUMNS, time_column
from gaitsweep.contract import Model, Quantity
from gaitsweep.dynamics.declarations import (
    Mode,
    Parameter,
    Reading,
    Symmetry,
    Time,
    Variable,
    faults_of_quantity,
)
from gaitsweep.dynamics.event_declarations import Event, SingleEvent
from gaitsweep.dynamics.footfalls import Footfalls
from gaitsweep.dynamics.ground import Ground, asks_for_ground, check_ground, ground_quantities
from gaitsweep.dynamics.noise import PATH, SEED, Diffusion, begun_path
from gaitsweep.dynamics.sliding import Sliding
from gaitsweep.expression import RESERVED
from gaitsweep.near_miss import suggestion
from gaitsweep.skeleton import LimbLook

Values = Mapping[str, jax.Array]
# Columns of traces, where signals have columns of their own names.
OF_TRACES = ("row", "t", "pass", "status", "stalled_by", "gait")
# The field of a state with the last steps of its feet (`Steps`).
STEPS = "steps"


def _record(model: type, name: str, fields: list[str], members: Mapping[str, Any]) -> type:
    """A frozen dataclass of arrays that JAX knows, as an attribute of the model's class.

    Args:
        model: the model's class.
        name: `Params` or `State`.
        fields: the names of its fields.
        members: its members besides these.
    """
    record = dataclasses.make_dataclass(
        name,
        [(field, jax.Array) for field in fields],
        frozen=True,
        namespace={"replace": _replaced, "__getattr__": _unknown, **members},
    )
    record.__module__ = model.__module__
    record.__qualname__ = f"{model.__qualname__}.{name}"
    record.__doc__ = f"The {'parameters' if name == 'Params' else 'variables and modes'} of {model.__name__}."
    return jax.tree_util.register_dataclass(record, data_fields=fields, meta_fields=[])


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
    """A value in the type and shape of an old one."""
    return jnp.broadcast_to(jnp.asarray(value, old.dtype), old.shape)


_DECLARED = (Parameter, Variable, Mode, Reading, Event, Symmetry, Footfalls, Diffusion, Sliding)


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
    # whether footfalls leave out short contacts and lifts
    contacts_bounce: ClassVar[bool] = False
    _members_of_state: ClassVar[Mapping[str, Any]] = {}  # besides its fields
    Params: ClassVar[type]
    State: ClassVar[type]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = {name: member for name, member in vars(cls).items() if isinstance(member, _DECLARED)}
        declared = {**cls._inherited(), **own}
        # a name that a subclass defines otherwise is no longer declared
        cls.declarations = {name: v for name, v in declared.items() if getattr(cls, name, None) is v}
        if "name" not in vars(cls):
            cls.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        cls._refuse_contradictions()
        if (feet := cls._feet()) is not None and cls.gaits is Declared.gaits:
            cls.gaits = feet.gaits
        cls.Params = _record(cls, "Params", [*cls._named(Parameter), *cls._other_parameters()], {})
        modes = [*cls._named(Mode), *cls._named(Sliding)]
        fields = [*cls._named(Variable), *modes, *cls._added_fields()]
        cls.State = _record(cls, "State", fields, cls._members_of_state)

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
        ground = ["ground"] if asks_for_ground(cls) else []
        noise = [] if cls._diffusion() is None else [SEED.name]
        return [*ground, *noise]

    def _ground(self) -> str | None:
        """The kind of ground, or its profile; None: the model does not ask for it."""
        return check_ground(getattr(self, "ground", "")) if asks_for_ground(type(self)) else None

    @classmethod
    @abc.abstractmethod
    def _other_fields(cls) -> list[str]:
        """Fields of a state that are not declared."""

    @classmethod
    def _added_fields(cls) -> list[str]:
        """Fields of a state that are not declared, with those of footfalls and noise."""
        feet = [] if cls._feet() is None else [STEPS]
        noise = [] if cls._diffusion() is None else [PATH]
        return [*cls._other_fields(), *feet, *noise]

    @classmethod
    def _diffusion(cls) -> Diffusion | None:
        """The declared noise of the flow; None: there is none."""
        return next(iter(cls._named(Diffusion).values()), None)

    @classmethod
    def _feet(cls) -> Footfalls | None:
        """The declared footfalls; None: there are none."""
        return next(iter(cls._named(Footfalls).values()), None)

    @abc.abstractmethod
    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        """Whether a state lies beyond the surface of an event."""

    @classmethod
    def _refuse_contradictions(cls) -> None:
        """Refuse declarations that exclude each other, or whose counts or values are wrong.

        Raises:
            TypeError: with the names of the declarations.
        """
        cls._refuse_names()
        cls._refuse_events_without_section()
        cls._refuse_footfalls()
        cls._refuse_sliding()
        sizes = cls._default_sizes()
        counts = cls._named_counts()
        for name, count in counts.items():
            if count not in sizes and not hasattr(cls, count):
                field = f"a field of its structure{suggestion(count, sizes) if sizes else ': it has none.'}"
                raise TypeError(f'{cls.__name__} declares {name} with count="{count}", which is not {field}')
        if all(isinstance(sizes.get(count), int) for count in counts.values()):
            wrong = next(cls._faults(sizes), None)
            if wrong is not None:
                raise TypeError(f"{cls.__name__} is a model {wrong}")

    @classmethod
    def _refuse_names(cls) -> None:
        """Refuse declarations with the names of members that every model has."""
        # the base that this package gives; its own declarations are no names of the user's
        base = next(base for base in cls.__mro__[1:] if base.__module__.startswith("gaitsweep.dynamics."))
        declared_by_base = getattr(base, "declarations", {})
        for name, declaration in cls.declarations.items():
            if declared_by_base.get(name) is declaration:
                continue
            if name in ("replace", *cls._added_fields()) or hasattr(base, name):
                raise TypeError(f"{cls.__name__} declares {name}, a name that every model has: rename it.")

    @classmethod
    def _refuse_events_without_section(cls) -> None:
        """Refuse events of which none closes a cycle."""
        events = cls.declared_events()
        if events and not any(event.section for event in events):
            remedy = "write section=True for the one that ends a cycle"
            raise TypeError(f"{cls.__name__} has events but no section: {remedy}.")

    @classmethod
    def _refuse_footfalls(cls) -> None:
        """Refuse footfalls without a clock, or beside gaits of the model's own that nothing assigns."""
        feet = cls._feet()
        if feet is None:
            return
        variables = cls._named(Variable)
        if feet.clock not in variables:
            near = suggestion(feet.clock, variables)
            raise TypeError(f"{cls.__name__} has footfalls of the clock {feet.clock}, no variable{near}")
        if cls.gaits not in (Declared.gaits, feet.gaits) and cls.label is Declared.label:
            remedy = f"leave gaits out, which then are {', '.join(feet.gaits)}, or write label"
            raise TypeError(f"{cls.__name__} has footfalls and gaits of its own without label: {remedy}.")

    @classmethod
    def _refuse_sliding(cls) -> None:
        """Refuse a surface of sliding that the flow does not know, or beside another."""
        surfaces = cls._named(Sliding)
        if len(surfaces) > 1:
            names = " and ".join(surfaces)
            raise TypeError(f"{cls.__name__} declares the surfaces of sliding {names}; only one is allowed.")
        for name, surface in surfaces.items():
            if getattr(getattr(cls, "flow", None), "sliding", None) is not surface:
                raise TypeError(f"{cls.__name__} declares {name} as sliding: write @{name}.flow above flow.")

    @classmethod
    def _named_counts(cls) -> dict[str, str]:
        """The fields of the structure that declarations name as their count, by the declaration."""
        counts: dict[str, str] = {}
        for name, declared in cls.declarations.items():
            if not isinstance(declared, Symmetry | Diffusion | Sliding) and isinstance(declared.count, str):
                counts[name] = declared.count
        return counts

    @classmethod
    def _default_sizes(cls) -> dict[str, Any]:
        """The fields of the structure with their defaults; the class is no dataclass yet."""
        hints: dict[str, Any] = {}
        for base in reversed(cls.__mro__):
            hints.update(inspect.get_annotations(base))
        sizes: dict[str, Any] = {}
        for name, hint in hints.items():
            if "ClassVar" not in str(hint):
                value = getattr(cls, name, None)
                sizes[name] = value.default if isinstance(value, dataclasses.Field) else value
        return sizes

    @classmethod
    def _faults(cls, sizes: Mapping[str, Any]) -> Iterator[str]:
        """Faults of names, units, bounds and defaults that the declarations alone show, as ends of sentences.

        Args:
            sizes: the fields of the structure by name.
        """
        # an instance cannot be made of a class that is not complete
        model = SimpleNamespace(
            **sizes,
            _named=cls._named,
            _recorded=cls._recorded,
            _feet=cls._feet,
            _ground=lambda: None,
            _diffusion=cls._diffusion,
        )
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
        singles = [single for event in cls.declared_events() for single in event.singles(model)]  # pyright: ignore[reportArgumentType]
        run_columns = {*COLUMNS, *(time_column(single.name) for single in singles)}
        columns = {q.name: (q.name, run_columns) for q in (*parameters, *starts)}
        columns |= {q.name: (q.name, OF_TRACES) for q in signals}
        columns |= {
            f"{q.name}{end}": (q.name, run_columns) for q in observables for end in ("", "_end", "_n")
        }
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
        events = dict.fromkeys(cls._named(Event).values())
        for surface in cls._named(Sliding).values():
            events |= dict.fromkeys(surface.events)
        return list(events)

    def single_events(self) -> list[SingleEvent]:
        """The declared events, one for each component and direction."""
        return [single for event in self.declared_events() for single in event.singles(self)]

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        declared = (
            q for name, parameter in self._named(Parameter).items() for q in parameter.parameters(self, name)
        )
        ground = self._ground()
        noise = () if self._diffusion() is None else (SEED,)
        return (*declared, *(() if ground is None else ground_quantities(ground)), *noise)

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        declared = {**self._named(Variable), **self._named(Mode)}
        return tuple(q for name, declaration in declared.items() for q in declaration.starts(self, name))

    @property
    def observables(self) -> tuple[Quantity, ...]:
        recorded = self._recorded("observed")
        feet = self._feet()
        declared = (q for name, declaration in recorded.items() for q in declaration.recorded(self, name))
        return (*declared, *(feet.observables if feet is not None else ()))

    @property
    def signals(self) -> tuple[Quantity, ...]:
        recorded = self._recorded("signal")
        feet = self._feet()
        declared = (q for name, declaration in recorded.items() for q in declaration.recorded(self, name))
        return (*declared, *(feet.signals if feet is not None else ()))

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        feet = self._feet()
        return feet.limbs if feet is not None else ()

    def section_variables(self) -> list[tuple[str, Variable]]:
        """The variables that are coordinates of the section, by name; clocks are none."""
        variables = self._named(Variable)
        feet = self._feet()
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
        if (ground := self._ground()) is not None:
            fields["ground"] = Ground.of(ground, values)
        if self._diffusion() is not None:
            fields[SEED.name] = jnp.asarray(values[SEED.name])
        return fields

    def observe(self, params: Any, state: Any, /) -> dict[str, Real[Array, ""]]:
        read = self._read("observed", params, state)
        feet = self._feet()
        return read if feet is None else read | feet.observed(self, params, state, state.steps)

    def signal(self, params: Any, state: Any, /) -> dict[str, Real[Array, ""]]:
        read = self._read("signal", params, state)
        feet = self._feet()
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
        for name in self._named(Sliding):
            fields[name] = jnp.asarray(1)  # before the variables decide it
        if (feet := self._feet()) is not None:
            fields[STEPS] = feet.begun(fields[feet.clock], debounced=self.contacts_bounce)
        if self._diffusion() is not None:
            fields[PATH] = begun_path()
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
