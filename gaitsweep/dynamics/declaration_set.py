"""All declarations of a model's class, by name, and the quantities that they make together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from gaitsweep.contract import Model, Quantity
from gaitsweep.dynamics.declarations import Mode, Parameter, Reading, Symmetry, Variable
from gaitsweep.dynamics.event_declarations import Event, SingleEvent
from gaitsweep.dynamics.footfalls import Footfalls
from gaitsweep.dynamics.noise import Diffusion
from gaitsweep.dynamics.sliding import Sliding

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
        return _joined(
            parameter.parameters(model, name) for name, parameter in self.of_kind(Parameter).items()
        )

    def starts(self, model: Model) -> tuple[Quantity, ...]:
        """The initial conditions of a model."""
        declared = self.of_kind(Variable) | self.of_kind(Mode)
        return _joined(declaration.starts(model, name) for name, declaration in declared.items())

    def observables(self, model: Model) -> tuple[Quantity, ...]:
        """The observables of a model, with those of its feet."""
        feet = () if self.feet is None else self.feet.observables
        recorded = self.recorded("observed").items()
        return (*_joined(declaration.recorded(model, name) for name, declaration in recorded), *feet)

    def signals(self, model: Model) -> tuple[Quantity, ...]:
        """The signals of a model, with the contacts of its feet."""
        feet = () if self.feet is None else self.feet.signals
        recorded = self.recorded("signal").items()
        return (*_joined(declaration.recorded(model, name) for name, declaration in recorded), *feet)


def _joined(quantities: Iterable[tuple[Quantity, ...]]) -> tuple[Quantity, ...]:
    """The quantities of several declarations, one after the other."""
    return tuple(quantity for several in quantities for quantity in several)
