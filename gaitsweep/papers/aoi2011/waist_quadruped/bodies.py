"""The rigid-body dynamics: gaitsweep's articulated tree, or MJX compiled for each row's body."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import abc
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.dynamics import evaluated_in
from gaitsweep.dynamics.tree import PointForce, integrate
from gaitsweep.expression import evaluate
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import WaistMechanics
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import (
    HEIGHT_NAMES,
    HEIGHTS,
    LIMBS,
    PARAMETERS,
    body,
    displacements,
    factors,
    mjcf,
    sizes_of,
)
from gaitsweep.papers.aoi2011.waist_quadruped.state import State

if TYPE_CHECKING:
    import mujoco

    from gaitsweep.dynamics.mjx import MjxBody, Variants


class WaistBody(abc.ABC):
    """The rigid-body dynamics of the quadruped: positions of the feet, a step, and values of a row."""

    compiled_of: tuple[str, ...] = ()  # the parameters for whose values the host compiles the body

    @property
    @abc.abstractmethod
    def variants(self) -> Variants | None:
        """The bodies that the host compiles for rows' values; None where it compiles none."""

    @abc.abstractmethod
    def feet(self, m: WaistMechanics, s: State, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
        """As `WaistMechanics.feet`, in the precision of a step.

        Args:
            m, s: the mechanics and the state of a row.
            dt: duration of the step, s; its dtype is the precision.
        """

    @abc.abstractmethod
    def stepped(
        self, m: WaistMechanics, s: State, tau: jax.Array, forces: list[PointForce], dt: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Positions (16,) and velocities (15,) after a step.

        Args:
            m, s: the mechanics and the state of a row.
            tau: generalised forces of the joints, (15,).
            forces: forces of the ground on the feet.
            dt: duration of the step, s.
        """


class WaistTreeBody(WaistBody):
    """The body as gaitsweep's articulated tree."""

    @property
    def variants(self) -> None:
        return None

    def feet(self, m: WaistMechanics, s: State, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
        return evaluated_in(dt.dtype, WaistMechanics.feet)(m, s.q, s.v)

    def stepped(
        self, m: WaistMechanics, s: State, tau: jax.Array, forces: list[PointForce], dt: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        v = s.v + dt * evaluated_in(dt.dtype, WaistMechanics.accelerations)(m, s.q, s.v, tau, forces)
        return jnp.asarray(integrate(body()[0], s.q, v, dt)), v


# The masses (kg) and lengths (m) of the body, which the host compiles; without heights where it is level.
_SIZES = (
    "front_mass", "rear_mass", "front_length", "front_width", "rear_length", "rear_width", "link_mass",
    "link_length", "front_hip_x", "rear_hip_x", "front_hip_y", "rear_hip_y", "body_distance",
)  # fmt: skip


class WaistMjxBody(WaistBody):
    """The body in MJX; the host compiles it for each row's masses, lengths and places of hips.

    Args:
        level: whether hips and the waist's axis are level with the centres of mass.
    """

    def __init__(self, *, level: bool) -> None:
        self.compiled_of = _SIZES if level else (*_SIZES, *HEIGHT_NAMES)

    @property
    def variants(self) -> Variants:
        return compiled_variants(self.compiled_of)

    def feet(self, m: WaistMechanics, s: State, dt: jax.Array) -> tuple[jax.Array, jax.Array]:
        return mjx_body().points(_numbers(m), s.q, s.v)

    def stepped(
        self, m: WaistMechanics, s: State, tau: jax.Array, forces: list[PointForce], dt: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        numbers = {**_numbers(m), "opt.gravity": m.gravity()}
        pushes = jnp.stack([push.force for push in forces])
        after, _ = mjx_body().step(numbers, mjx_body().start(s.q, s.v), dt, tau=tau, forces=pushes)
        return after.q, after.v


def _numbers(m: WaistMechanics) -> dict[str, jax.Array]:
    """The fields of an mjx.Model that belong to these masses and lengths."""
    if not m.numbers:
        raise ValueError("With body mjx, call the model's on_host before its params.")
    return m.numbers


# MJX is imported here, since that takes seconds and reading a job does not need it
@cache
def mjx_body() -> MjxBody:
    """The body with the values of Table I."""
    from gaitsweep.dynamics.mjx import MjxBody

    return MjxBody(mjcf(), [f"foot_{i + 1}" for i in LIMBS])


@cache
def compiled_variants(names: tuple[str, ...] = _SIZES) -> Variants:
    """The bodies with other values of some masses, lengths and heights; Table I's are the defaults."""
    from gaitsweep.dynamics.mjx import Variants, rescale

    def edit(spec: mujoco.MjSpec, values: Mapping[str, float]) -> None:
        sizes = sizes_of(values)
        rescale(spec, *factors(sizes, np.stack))
        hips, centre = displacements(sizes, np.stack)
        for name, by in hips.items():
            spec.body(name).pos = spec.body(name).pos + by
        spec.body("rear").ipos = spec.body("rear").ipos + centre

    of_table_1: dict[str, float] = {}
    for quantity in (*PARAMETERS, *HEIGHTS):
        of_table_1[quantity.name] = evaluate(quantity.default or 0.0, of_table_1)
    return Variants(mjcf(), edit, {name: of_table_1[name] for name in names})
