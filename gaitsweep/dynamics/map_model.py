"""Plain maps by declaration: the image of a state, without a flow, a clock or events."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from gaitsweep.contract import Chart, Params, State, SteppedModel
from gaitsweep.dynamics.declared import Declared
from gaitsweep.dynamics.event_declarations import Event, SingleEvent
from gaitsweep.dynamics.gaits_by_footfalls import Footfalls
from gaitsweep.dynamics.noise import Diffusion
from gaitsweep.dynamics.section_coordinates import SectionCoordinates

# Declarations that a flow alone has. Numbers that `normal` draws in `image` are the noise of a map.
_OF_FLOWS = {Event: "event", Footfalls: "footfalls", Diffusion: "diffusion"}


@dataclasses.dataclass(frozen=True)
class MapModel(Declared, SteppedModel):
    """A map x -> f(x) whose class body declares its parameters and variables.

    1. A model gives `image`, and declares a `parameter` and a `variable`. Fields of its structure need
       `@dataclasses.dataclass(frozen=True)`.
    2. It may give the declarations `mode`, `observable`, `signal`, `symmetry` and `energy` (with
       `conserved=True`, what the map keeps), and optional members: `source`, `gaits` with `label`, `failed`.
    3. The engine alone calls the members that are built from them.

    Every application of the map is a crossing of the section, so the map is its own return map, with its
    exact derivative. Times in tables are numbers of applications.

    Example:
        The logistic map has a stable orbit of period 2 between r = 3 and 1 + sqrt 6:

        >>> import gaitsweep as gs
        >>> class Logistic(gs.MapModel):
        ...     r = gs.parameter("1", "rate of growth", 3.2)
        ...     x = gs.variable("1", "population", 0.3)
        ...
        ...     def image(self, p, s):
        ...         return {"x": p.r * s.x * (1.0 - s.x)}
        >>> table = gs.sweep(Logistic(), r=[2.8, 3.2, 3.5]).table
        >>> table["attractor_period"].tolist()
        [1, 2, 4]
        >>> gs.return_map(Logistic(), r=3.2).multipliers([1.0 - 1.0 / 3.2]).round(6).tolist()
        [(-1.2+0j)]
    """

    is_return_map: ClassVar[bool] = True

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, declaration in cls.declarations.items():
            what = next((noun for kind, noun in _OF_FLOWS.items() if isinstance(declaration, kind)), None)
            if what is not None:
                raise TypeError(
                    f"{cls.__name__} declares {name}, but a map has no {what}: derive it from DeclaredModel."
                )

    @classmethod
    def _other_fields(cls) -> list[str]:
        return []

    def _is_beyond(self, event: SingleEvent, params: Params, state: State) -> Bool[Array, ""]:
        return jnp.zeros((), bool)

    @abc.abstractmethod
    def image(self, params: Params, state: State, /) -> Mapping[str, Real[Array, " ..."]]:
        """The variables and modes of the image of a state, by name; the others keep their values."""

    def init(self, params: Params, start: Mapping[str, Float[Array, ""]], /) -> State:
        return self.complete(params, self.State(**self._started(start)))

    @final
    def step(self, params: Params, state: State, dt: Float[Array, ""], /) -> State:
        return state.replace(**self.image(params, state))

    @final
    def events(self, params: Params, before: State, after: State, /) -> Bool[Array, " events"]:
        return jnp.ones((1,), bool)

    @final
    def jump(self, params: Params, state: State, fired: Bool[Array, " events"], /) -> State:
        return state

    @final
    def section(self, params: Params, before: State, fired: Bool[Array, " events"], /) -> Bool[Array, ""]:
        return fired[0]

    @final
    def period(self, params: Params, /) -> Float[Array, ""]:
        """One application."""
        return jnp.ones(())

    @final
    def longest_step(self, params: Params, /) -> Float[Array, ""]:
        return self.period(params)

    def chart(self) -> Chart | None:
        return SectionCoordinates(self)
