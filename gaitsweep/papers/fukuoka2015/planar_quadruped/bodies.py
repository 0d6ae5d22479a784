"""The rigid-body dynamics: gaitsweep's articulated tree on compliant feet, or MJX with MuJoCo's contacts."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import abc
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaitsweep.dynamics import ground_force, uneven_ground_force
from gaitsweep.dynamics.tree import (
    Geometry,
    YieldingForce,
    forward_dynamics,
    integrate,
    movements,
    places,
    velocity_at,
)
from gaitsweep.expression import evaluate
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import HIP_SIGNS, NQ, PlanarMechanics, body, mjcf
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS
from gaitsweep.papers.fukuoka2015.planar_quadruped.parameters import BODY
from gaitsweep.papers.fukuoka2015.planar_quadruped.rhythm import swinging
from gaitsweep.papers.fukuoka2015.planar_quadruped.state import State

if TYPE_CHECKING:
    import mujoco

    from gaitsweep.dynamics.mjx import MjxBody, Variants


class AfterStep(NamedTuple):
    """The body after a step: `q`, `v` and `warm` as in `State`, and the loads on the feet, (4,) N."""

    q: jax.Array
    v: jax.Array
    warm: jax.Array
    load: jax.Array


# Largest value of the stability number of `PlanarTreeBody.longest_step`, whose limit is 2.
STABILITY_NUMBER = 1.5


class PlanarBody(abc.ABC):
    """The rigid-body dynamics of the quadruped."""

    compiled_of: ClassVar[tuple[str, ...]] = ()  # the parameters for whose values the host compiles the body
    warm: ClassVar[int] = 0  # length of `State.warm`

    @property
    @abc.abstractmethod
    def variants(self) -> Variants | None:
        """The bodies that the host compiles for rows' values; None where it compiles none."""

    @abc.abstractmethod
    def longest_step(self, m: PlanarMechanics) -> Float[Array, ""]:
        """The longest step (s) with stable contacts."""

    @abc.abstractmethod
    def stepped(self, m: PlanarMechanics, s: State, tau: jax.Array, dt: jax.Array) -> AfterStep:
        """The body after a step.

        Args:
            m, s: the mechanics and the state of a row.
            tau: generalised forces of the motors, (11,).
            dt: duration of the step, s.
        """


class PlanarTreeBody(PlanarBody):
    """The articulated tree with semi-implicit steps; joint damping and friction are implicit."""

    @property
    def variants(self) -> None:
        return None

    def longest_step(self, m: PlanarMechanics) -> Float[Array, ""]:
        """The longest stable step (s) of a foot on a spring and a damper.

        Semi-implicit steps are stable if (D dt + K dt^2 / 2) w < 2, with w the foot's inverse effective mass.
        """
        w = 1.0 / (m.lower_mass + m.foot_mass) + 0.5 / (m.upper_mass + m.lower_mass + m.foot_mass)
        root = jnp.sqrt(m.D_foot * m.D_foot + 2.0 * STABILITY_NUMBER * m.K_foot / w)
        return (root - m.D_foot) / m.K_foot

    def stepped(self, m: PlanarMechanics, s: State, tau: jax.Array, dt: jax.Array) -> AfterStep:
        tree, _ = body()
        geometry = m.geometry(swinging(s.u), dt)
        feet, loads = zip(*_ground_forces(m, geometry, s, dt), strict=True)
        a = forward_dynamics(tree, geometry, s.q, s.v, tau, feet, gravity=m.gravity())
        v = s.v + dt * a
        return AfterStep(jnp.asarray(integrate(tree, s.q, v, dt)), v, s.warm, jnp.stack(loads))


def _ground_forces(
    m: PlanarMechanics, geometry: Geometry, s: State, dt: jax.Array
) -> list[tuple[YieldingForce, jax.Array]]:
    """The force of the ground on each foot in a step of `dt` (s), and its part across the ground (N)."""
    tree, _ = body()
    placed = places(tree, geometry, s.q)
    moving = movements(tree, placed, s.v)
    ground = {"K": m.K_foot, "D": m.D_foot, "mu": m.mu, "v_slip": m.v_slip}
    zero = jnp.zeros_like(m.g)
    # the centre of the foot's sphere in its leg, and its lowest point relative to the centre
    middle, down = jnp.stack([zero, zero, m.foot_radius]), jnp.stack([zero, zero, -m.foot_radius])
    feet = []
    for leg in LEGS:
        i = tree.index(f"lower_{leg}")
        centre = placed[i].position(middle)
        if m.ground is None:
            at = centre + down
            force = ground_force(i, at, velocity_at(placed[i], moving[i], at), dt, **ground)
            feet.append((force, force.force[2]))
            continue
        normal = m.ground.normal(centre[0])
        at = centre - m.foot_radius * normal
        velocity = velocity_at(placed[i], moving[i], at)
        feet.append(uneven_ground_force(i, at, velocity, dt, m.ground, normal, **ground))
    return feet


class PlanarMjxBody(PlanarBody):
    """The body in MJX, with MuJoCo's contact solver."""

    compiled_of = tuple(quantity.name for quantity in BODY)
    warm = NQ

    @property
    def variants(self) -> Variants:
        return compiled_variants()

    def longest_step(self, m: PlanarMechanics) -> Float[Array, ""]:
        return jnp.full_like(m.g, jnp.inf)  # MuJoCo's contacts are implicit

    def stepped(self, m: PlanarMechanics, s: State, tau: jax.Array, dt: jax.Array) -> AfterStep:
        from gaitsweep.dynamics.mjx import BodyState

        in_mjx = mjx_body()
        friction = jnp.asarray(in_mjx.mj_model.geom_friction)
        sliding = jnp.full_like(friction[:, :1], 1.0) * m.mu
        numbers = {
            **m.numbers,
            "opt.gravity": m.gravity(),
            "dof_damping": m.damping(swinging(s.u)),
            "geom_friction": jnp.concatenate([sliding, friction[:, 1:]], axis=1),
        }
        empty = jnp.zeros((0,), s.q.dtype)
        before = BodyState(s.q, s.v, empty, s.warm, empty)
        after, data = in_mjx.step(numbers, before, dt, tau=tau)
        return AfterStep(after.q, after.v, after.warm, in_mjx.pressures(data).astype(s.q.dtype))


# MJX is imported here, since that takes seconds and reading a job does not need it
@cache
def mjx_body() -> MjxBody:
    """The body of the MJCF."""
    from gaitsweep.dynamics.mjx import MjxBody

    return MjxBody(mjcf(), contact=True)


@cache
def compiled_variants() -> Variants:
    """The bodies with other masses and lengths."""
    from gaitsweep.dynamics.mjx import Variants

    return Variants(mjcf(), edit, default_body())


def default_body() -> dict[str, float]:
    """The default body parameters, those of the MJCF, by name."""
    defaults: dict[str, float] = {}
    for quantity in BODY:
        defaults[quantity.name] = evaluate(quantity.default or 0.0, defaults)
    return defaults


def edit(spec: mujoco.MjSpec, values: Mapping[str, float]) -> None:
    """Set a mujoco.MjSpec of the body to these masses and lengths."""
    torso = spec.body("torso")
    torso.ipos = [values["com_x"], 0.0, values["com_z"]]
    torso.mass = values["torso_mass"]
    # only the inertia about y has an effect; the others are scaled, so that MuJoCo accepts them
    torso.inertia = values["torso_inertia"] / torso.inertia[1] * torso.inertia
    radius = values["foot_radius"]
    for leg, side in zip(LEGS, HIP_SIGNS, strict=True):
        upper, lower = spec.body(f"upper_{leg}"), spec.body(f"lower_{leg}")
        upper.pos = [side * values["hip_x"], upper.pos[1], 0.0]
        lower.pos = [0.0, 0.0, -values["l_0"]]
        thigh, shin, foot = (spec.geom(f"{part}_{leg}") for part in ("upper", "lower", "foot"))
        thigh.mass, shin.mass, foot.mass = (values[f"{part}_mass"] for part in ("upper", "lower", "foot"))
        thigh.fromto = [0.0, 0.0, 0.0, 0.0, 0.0, -values["upper_length"]]
        shin.fromto = [0.0, 0.0, radius, 0.0, 0.0, radius + values["lower_length"]]
        foot.pos, foot.size = [0.0, 0.0, radius], [radius, 0.0, 0.0]
        for site in lower.sites:
            site.pos = [0.0, 0.0, radius]
