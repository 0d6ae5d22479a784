"""Quantities, parameters and states of a model from its declarations, and what is read from them."""

from __future__ import annotations

import abc
import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Model, Quantity
from gaitsweep.dynamics.declaration_faults import refuse_contradictions
from gaitsweep.dynamics.declarations import Mode, Parameter, Reading, Symmetry, Time, Variable
from gaitsweep.dynamics.event_declarations import Event, SingleEvent
from gaitsweep.dynamics.gaits_by_footfalls import Footfalls
from gaitsweep.dynamics.ground import Ground, asks_for_ground, check_ground, ground_quantities
from gaitsweep.dynamics.noise import PATH, SEED, Diffusion, NoisePath
from gaitsweep.dynamics.sliding import Sliding
from gaitsweep.near_miss import suggestion
from gaitsweep.skeleton import LimbLook

_KINDS = (Parameter, Variable, Mode, Reading, Event, Symmetry, Footfalls, Diffusion, Sliding)


class DeclarationSet(dict[str, Any]):
    """The declarations of a class and its bases by name, in the order of their declaration."""

    @classmethod
    def of_class(cls, model: type[Model]) -> DeclarationSet:
        """Collect the declarations of a class and its bases, without those set to None.

        Raises:
            TypeError: a member that is not a declaration has the name of one.
        """
        declared: dict[str, Any] = {}
        # an event whose jump has another name is an attribute under both; its own name is the first
        first_names: dict[Event, str] = {}
        for base in reversed(model.__mro__):
            for name, member in vars(base).items():
                if isinstance(member, _KINDS):
                    declared[name] = member
                    if isinstance(member, Event):
                        first_names.setdefault(member, name)
        kept = cls()
        for name, declaration in declared.items():
            member = getattr(model, name, None)
            event = first_names[declaration] if isinstance(declaration, Event) else name
            if event != name and getattr(model, event, None) is not declaration:
                continue  # the jump of an event that this class replaces
            if member is declaration:
                kept[name] = declaration
            elif event != name:
                raise TypeError(
                    f"{model.__name__} defines {name}, the name of the jump of {event} in its base: declare "
                    f"the event {event} again, with its jump."
                )
            elif member is not None:
                raise TypeError(
                    f"{model.__name__} defines {name}, which its base declares, without a declaration: "
                    f"declare it again, or write {name} = None to remove it."
                )
        return kept

    def of_kind(self, kind: type) -> dict[str, Any]:
        """The declarations of one kind, by name."""
        return {name: declaration for name, declaration in self.items() if isinstance(declaration, kind)}

    @property
    def diffusion(self) -> Diffusion | None:
        """The noise of the flow; None: there is none."""
        return next(iter(self.of_kind(Diffusion).values()), None)

    @property
    def feet(self) -> Footfalls | None:
        """The footfalls; None: there are none."""
        return next(iter(self.of_kind(Footfalls).values()), None)

    @property
    def events(self) -> list[Event]:
        """The events, each once."""
        events = dict.fromkeys(self.of_kind(Event).values())
        for surface in self.of_kind(Sliding).values():
            events |= dict.fromkeys(surface.events)
        return list(events)

    def single_events(self, model: Model) -> list[SingleEvent]:
        """The events of a model, one for each component and direction."""
        return [single for event in self.events for single in event.singles(model)]

    def recorded(self, kind: str) -> dict[str, Variable | Reading]:
        """The declarations that are recorded as "observed" or as "signal"."""
        recorded = self.of_kind(Variable) | self.of_kind(Reading)
        return {name: recorded[name] for name in self if getattr(recorded.get(name), kind, False)}

    def parameters(self, model: Model) -> tuple[Quantity, ...]:
        """The parameters of a model; here and below only the fields of its structure are read."""
        declared = self.of_kind(Parameter).items()
        return tuple(q for name, parameter in declared for q in parameter.parameters(model, name))

    def starts(self, model: Model) -> tuple[Quantity, ...]:
        """The initial conditions of a model."""
        declared = (self.of_kind(Variable) | self.of_kind(Mode)).items()
        return tuple(q for name, declaration in declared for q in declaration.starts(model, name))

    def observables(self, model: Model) -> tuple[Quantity, ...]:
        """The observables of a model, with those of its feet."""
        return self._recorded_of(model, "observed") + (() if self.feet is None else self.feet.observables)

    def signals(self, model: Model) -> tuple[Quantity, ...]:
        """The signals of a model, with the contacts of its feet."""
        return self._recorded_of(model, "signal") + (() if self.feet is None else self.feet.signals)

    def _recorded_of(self, model: Model, kind: str) -> tuple[Quantity, ...]:
        """The quantities that are recorded as "observed" or as "signal", without those of the feet."""
        recorded = self.recorded(kind).items()
        return tuple(q for name, declaration in recorded for q in declaration.recorded(model, name))


Values = Mapping[str, jax.Array]
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
    for name, value in changes.items():
        if name not in fields:
            raise TypeError(f"{type(self).__qualname__} has no field {name}{suggestion(name, fields)}")
        if any(map(jnp.iscomplexobj, jax.tree.leaves(value))):
            raise TypeError(f"{type(self).__qualname__} has real numbers, but {name} is given complex ones")
    cast = {name: jax.tree.map(_like, fields[name], value) for name, value in changes.items()}
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


@dataclasses.dataclass(frozen=True)
class Declared(Model):
    """Quantities, parameters and states that declarations give to a model of either family.

    The members of the contract that are built here are optional: a model may define any of them itself.

    Raises:
        TypeError: two declarations exclude each other; the message names them.
    """

    source: ClassVar[str] = ""
    gaits: ClassVar[tuple[str, ...]] = ("none",)
    declarations: ClassVar[DeclarationSet] = DeclarationSet()
    # whether footfalls leave out short contacts and lifts
    contacts_bounce: ClassVar[bool] = False
    _members_of_state: ClassVar[Mapping[str, Any]] = {}  # besides its fields
    Params: ClassVar[type]
    State: ClassVar[type]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.declarations = DeclarationSet.of_class(cls)
        if "name" not in vars(cls):
            cls.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()
        declared = cls.declarations
        if declared.feet is not None and cls.gaits == Declared.gaits:
            cls.gaits = declared.feet.gaits
        refuse_contradictions(cls, cls._added_fields(), labels=cls.label is not Declared.label)
        cls.Params = _record(cls, "Params", [*declared.of_kind(Parameter), *cls._other_parameters()], {})
        modes = [*declared.of_kind(Mode), *declared.of_kind(Sliding)]
        fields = [*declared.of_kind(Variable), *modes, *cls._added_fields()]
        cls.State = _record(cls, "State", fields, cls._members_of_state)

    @classmethod
    def _other_parameters(cls) -> list[str]:
        """Fields of the parameters that are not declared."""
        ground = ["ground"] if asks_for_ground(cls) else []
        noise = [] if cls.declarations.diffusion is None else [SEED.name]
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
        feet = [] if cls.declarations.feet is None else [STEPS]
        noise = [] if cls.declarations.diffusion is None else [PATH]
        return [*cls._other_fields(), *feet, *noise]

    @abc.abstractmethod
    def _is_beyond(self, event: SingleEvent, params: Any, state: Any) -> Bool[Array, ""]:
        """Whether a state lies beyond the surface of an event."""

    def single_events(self) -> list[SingleEvent]:
        """The declared events, one for each component and direction."""
        return self.declarations.single_events(self)

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        ground = self._ground()
        noise = () if self.declarations.diffusion is None else (SEED,)
        of_ground = () if ground is None else ground_quantities(ground)
        return (*self.declarations.parameters(self), *of_ground, *noise)

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return self.declarations.starts(self)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        return self.declarations.observables(self)

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return self.declarations.signals(self)

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        feet = self.declarations.feet
        return feet.limbs if feet is not None else ()

    def section_variables(self) -> list[tuple[str, Variable]]:
        """The variables that are coordinates of the section, by name; clocks are none."""
        variables = self.declarations.of_kind(Variable)
        feet = self.declarations.feet
        clocks = {name for name, variable in variables.items() if isinstance(variable, Time)}
        clocks |= set() if feet is None else {feet.clock}
        return [(name, variable) for name, variable in variables.items() if name not in clocks]

    def complete(self, params: Any, state: Any, /) -> Any:
        """The state with those variables set that follow from the others, at t = 0 and on the section.

        A model with `section_coordinates` sets here what the section fixes, such as the swing leg of a
        walker whose feet are both on the ground.
        """
        return state

    def symmetries(self) -> Mapping[str, Callable[[Any, Any], Any]]:
        def image(declared: Symmetry) -> Callable[[Any, Any], Any]:
            return lambda params, state: self._begun(params, declared.function(self, params, state))

        return {name: image(declared) for name, declared in self.declarations.of_kind(Symmetry).items()}

    def _begun(self, params: Any, state: Any, *, crossed: bool = False) -> Any:
        """The state with its events armed by where it lies and moves."""
        return state

    def begun_on_section(self, params: Any, state: Any) -> Any:
        """A state on the section, just behind its crossing, with its events armed."""
        return self._begun(params, state, crossed=True)

    def params(self, values: Values, /) -> Any:
        return self.Params(**self._gathered(values))

    def _gathered(self, values: Values) -> dict[str, Any]:
        """The declared fields of the parameters."""
        fields: dict[str, Any] = {
            name: parameter.gathered([jnp.asarray(values[q.name]) for q in parameter.quantities(self, name)])
            for name, parameter in self.declarations.of_kind(Parameter).items()
        }
        if (ground := self._ground()) is not None:
            fields["ground"] = Ground.of(ground, values)
        if self.declarations.diffusion is not None:
            fields[SEED.name] = jnp.asarray(values[SEED.name])
        return fields

    def observe(self, params: Any, state: Any, /) -> dict[str, Real[Array, ""]]:
        read = self._read("observed", params, state)
        feet = self.declarations.feet
        return read if feet is None else read | feet.observed(self, params, state, state.steps)

    def signal(self, params: Any, state: Any, /) -> dict[str, Real[Array, ""]]:
        read = self._read("signal", params, state)
        feet = self.declarations.feet
        if feet is None:
            return read
        down = feet.down(self, params, state).astype(float)
        return read | {quantity.name: value for quantity, value in zip(feet.signals, down, strict=True)}

    def label(self, params: Any, observations: Values, /) -> dict[str, Any]:
        feet = self.declarations.feet
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
        for name, declaration in self.declarations.of_kind(Variable).items():
            numbers = [jnp.asarray(start[q.name]) for q in declaration.starts(self, name)]
            fields[name] = declaration.gathered(numbers) if numbers else jnp.zeros(declaration.shape(self))
        for name, declaration in self.declarations.of_kind(Mode).items():
            fields[name] = declaration.at_start(
                self, [start.get(q.name, q.default) for q in declaration.starts(self, name)]
            )
        for name in self.declarations.of_kind(Sliding):
            fields[name] = jnp.asarray(1)  # before the variables decide it
        if (feet := self.declarations.feet) is not None:
            fields[STEPS] = feet.begun(fields[feet.clock], debounced=self.contacts_bounce)
        if self.declarations.diffusion is not None:
            fields[PATH] = NoisePath(jnp.zeros((), jnp.int64), jnp.zeros(()))
        return fields

    def _stepped(self, params: Any, before: Any, after: Any, reset: Float[Array, ""] | None = None) -> Any:
        """The state `after` a jump with the steps of its feet; `reset`: by which (s) its clock was set.

        By default that is the whole change of the clock.
        """
        if (feet := self.declarations.feet) is None:
            return after
        if reset is None:
            reset = jnp.asarray(getattr(after, feet.clock) - getattr(before, feet.clock))
        return after.replace(steps=feet.after(self, params, before.steps, before, after, reset))

    def _read(self, kind: str, params: Any, state: Any) -> dict[str, jax.Array]:
        recorded = self.declarations.recorded(kind).items()
        read = (reading.values(self, name, params, state) for name, reading in recorded)
        return {name: value for values in read for name, value in values.items()}

    def _flags(self, fired: Bool[Array, " events"]) -> Iterator[tuple[SingleEvent, Bool[Array, " guards"]]]:
        """Each event with the flags of its guards."""
        first = 0
        for event in self.single_events():
            last = first + len(event.guard_names)
            yield event, fired[first:last]
            first = last
