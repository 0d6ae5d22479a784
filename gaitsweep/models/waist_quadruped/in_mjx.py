"""The quadruped's body as MJX steps it, compiled for each row's masses and lengths."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.dynamics.external_force import PointForce
from gaitsweep.models.waist_quadruped.mechanics import LIMBS, WaistMechanics, factors, mjcf
from gaitsweep.models.waist_quadruped.state import State
from gaitsweep.models.waist_quadruped.steps import WaistBody

if TYPE_CHECKING:
    from gaitsweep.dynamics.mjx.body import MjxBody
    from gaitsweep.dynamics.mjx.variants import Variants

# Table I's masses (kg) and lengths (m), which the MJCF has.
_TABLE_1 = {"body_mass": 1.0, "body_length": 0.1, "body_width": 0.1, "link_mass": 0.1, "link_length": 0.08}
# Before the names of what the host adds to a row's values: fields of the model, and what they were made of.
_FIELD, _MADE_OF = "mjx.", "mjx of "


class WaistMjxBody(WaistBody):
    """The body as MJX steps it; the host compiles it for each row's masses and lengths."""

    compiled_of = tuple(_TABLE_1)

    def on_host(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The values (n,) with the rows' fields of an mjx.Model (n, ...) besides."""
        fields = variants().numbers(values)
        return {
            **values,
            **{_FIELD + name: field for name, field in fields.items()},
            **{_MADE_OF + name: values[name] for name in self.compiled_of},
        }

    def numbers(self, values: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """The fields of an mjx.Model among a row's values; NaN where they are of other masses or lengths.

        None of them where the values have not been through `on_host`: enough where the body is not moved.
        """
        if _MADE_OF + self.compiled_of[0] not in values:
            return {}
        # a ramp would move them away from what was compiled
        same = jnp.all(jnp.stack([values[name] == values[_MADE_OF + name] for name in self.compiled_of]))
        fields = {name: values[_FIELD + name] for name in variants().fields}
        return {name: jnp.where(same, field, jnp.nan) for name, field in fields.items()}

    def feet(self, m: WaistMechanics, s: State, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
        return mjx_body().points(_numbers(m), s.q, s.v)

    def moved(
        self, m: WaistMechanics, s: State, tau: jax.Array, forces: list[PointForce], dt: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        numbers = {**_numbers(m), "opt.gravity": m.gravity()}
        pushes = jnp.stack([push.force for push in forces])
        after = mjx_body().step(numbers, mjx_body().start(s.q, s.v), dt, tau=tau, forces=pushes)
        return after.q, after.v


def _numbers(m: WaistMechanics) -> dict[str, jax.Array]:
    if not m.numbers:
        raise ValueError("With body mjx, values go through the model's on_host before its params.")
    return m.numbers


# MJX takes seconds to import, and a job is read without it
@cache
def mjx_body() -> MjxBody:
    """The body of Table I."""
    from gaitsweep.dynamics.mjx.body import MjxBody

    return MjxBody(mjcf(), [f"foot_{i + 1}" for i in LIMBS])


@cache
def variants() -> Variants:
    """The bodies of other masses and lengths."""
    from gaitsweep.dynamics.mjx.variants import Variants, rescale

    def edit(spec: Any, values: Mapping[str, float]) -> None:
        rescale(spec, *factors(SimpleNamespace(**values), np.stack))

    return Variants(mjcf(), edit, _TABLE_1)
