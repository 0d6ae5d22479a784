"""A model whose texts a page could take for HTML, TeX or a program: quotes, tags, the end of a script."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp

from double_well import DoubleWell, State
from gaitsweep.contract import Quantity

ATTACK = "</script><img src=x onerror=\"window.taken='yes'\">"


class HostileTexts(DoubleWell):
    """The particle <b>in</b> "its" wells & nothing else; beyond 1.4 m it has fallen."""

    name: ClassVar[str] = "hostile_texts"
    source: ClassVar[str] = f"this file {ATTACK}"
    gaits: ClassVar[tuple[str, ...]] = ("left <i>&amp;", 'right "it\'s"')

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        return (Quantity("lean", "m/s<sup>2", f"error of a step {ATTACK}", 0.0, symbol="l<e&a'n"),)

    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return (Quantity("x_0", 'm"<u>', "where it starts", 0.5, symbol="x<0"),)

    @property
    def observables(self) -> tuple[Quantity, ...]:
        speed = Quantity("v", "m/s", "its <speed>", symbol=r"\dot{x}")
        return (Quantity("x", 'm"<u>', f"where it is {ATTACK}", symbol=rf"\text{{x{ATTACK}}}"), speed)

    def observe(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return {"x": state.x, "v": state.x - state.x**3}

    def signal(self, params: dict[str, jax.Array], state: State) -> dict[str, jax.Array]:
        return self.observe(params, state)

    def failed(self, params: dict[str, jax.Array], state: State) -> jax.Array:
        return jnp.abs(state.x) > 1.4

    def label(
        self, params: dict[str, jax.Array], observations: Mapping[str, jax.Array]
    ) -> dict[str, jax.Array]:
        return {"gait": jnp.where(observations["x"] > 0.0, 1, 0)}
