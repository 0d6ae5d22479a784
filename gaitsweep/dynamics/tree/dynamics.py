"""Forward dynamics of an articulated tree (Featherstone 2008, ch. 7)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaitsweep.dynamics.tree.articulated_tree import WORLD, Geometry, Tree
from gaitsweep.dynamics.tree.kinematics import Movement, Place, movements, places
from gaitsweep.dynamics.tree.spatial import (
    EYE,
    ZERO,
    Array,
    ForceVector,
    Inertia,
    MotionVector,
    Scalar,
    cross,
    skew,
    solve_positive,
    symmetric,
    turned,
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PointForce:
    """A force on a point of a body.

    `link` is the link's number; `point` (3,) m is in the body's frame; `force` (3,) N in the world's axes.
    """

    link: int = dataclasses.field(metadata={"static": True})
    point: Float[Array, " 3"]
    force: Float[Array, " 3"]

    def on(self, place: Place) -> ForceVector:
        """The spatial force about the link's point, in the link's axes."""
        force = place.frame.T @ self.force
        return ForceVector(cross(place.turn @ (self.point - place.anchor), force), force)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class WorldForce:
    """A force on a body at a point in the world.

    `link` is the link's number; `at` (3,) m is the point and `force` (3,) N, both in the world's axes.
    """

    link: int = dataclasses.field(metadata={"static": True})
    at: Float[Array, " 3"]
    force: Float[Array, " 3"]

    def on(self, place: Place) -> ForceVector:
        """The spatial force about the link's point, in the link's axes."""
        return _force_at(place, self.at, self.force)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class YieldingForce:
    """A force that decreases with the acceleration of its point: `force` - `yields` times the acceleration.

    An implicit damper is such a force: with the coefficient c and a step of dt, `yields` is dt c.

    `link` is the link's number; `at` (3,) m is the point in the world; `force` (3,) N and `yields` (3,) kg
    are along the world's axes; `yields` may also be a symmetric matrix (3, 3) kg between them.
    """

    link: int = dataclasses.field(metadata={"static": True})
    at: Float[Array, " 3"]
    force: Float[Array, " 3"]
    yields: Float[Array, " 3"] | Float[Array, "3 3"]

    def on(self, place: Place) -> ForceVector:
        """The spatial force at zero acceleration, about the link's point, in the link's axes."""
        return _force_at(place, self.at, self.force)

    def inertia(self, place: Place) -> Inertia:
        """`yields` as a spatial inertia about the link's point: a point mass that differs by axis."""
        frame = place.frame.T
        M = turned(frame, EYE * self.yields[:, None] if self.yields.ndim == 1 else self.yields)
        rx = skew(_lever(place, self.at))
        H = rx @ M
        return Inertia(symmetric(H @ rx.T), H, M)

    def at_rest(self, place: Place, w: Float[Array, " 3"], gravity: Float[Array, " 3"]) -> MotionVector:
        """The acceleration of the force's point if its link's point and axes do not accelerate.

        Args:
            place: the link's place.
            w: its angular velocity (3,) rad/s, in its axes.
            gravity: acceleration (3,) m/s2, which the algorithm subtracts from accelerations.
        """
        # given as an acceleration of the link's point, as `inertia` expects
        return MotionVector(ZERO, cross(w, cross(w, _lever(place, self.at))) + place.frame.T @ gravity)


External: TypeAlias = Sequence[PointForce | WorldForce | YieldingForce]


def _lever(place: Place, at: Array) -> Array:
    """A point in the world, from the link's point and in the link's axes."""
    return place.frame.T @ (at - place.base) - place.reach


def _force_at(place: Place, at: Array, force: Array) -> ForceVector:
    """The spatial force about the link's point of a force at a point, both in the world's axes."""
    turned_force = place.frame.T @ force
    return ForceVector(cross(_lever(place, at), turned_force), turned_force)


@dataclasses.dataclass(frozen=True)
class _Body:
    """The velocity-dependent quantities of a link, about its point and in its axes.

    `inertia` is that of its body; `bias` the bias force at zero (classical) acceleration, less the external
    forces; `S` the motion subspace of a hinge or slide; `c` the velocity-product acceleration of its point,
    in the parent's axes.
    """

    place: Place
    inertia: Inertia
    bias: ForceVector
    S: MotionVector
    c: MotionVector


def forward_dynamics(
    tree: Tree,
    geometry: Geometry,
    q: Float[Array, " nq"],
    v: Float[Array, " nv"],
    tau: Float[Array, " nv"],
    external: External = (),
    *,
    gravity: Float[Array, " 3"],
) -> Float[Array, " nv"]:
    """Accelerations dv/dt (nv,), rad/s2 and m/s2, by the articulated-body algorithm (table 7.1).

    Args:
        tree, geometry: the links.
        q, v: positions (nq,) and velocities (nv,), as MuJoCo's qpos and qvel.
        tau: generalised forces (nv,), N m and N, as MuJoCo's qfrc_applied; the joints' dampers and springs
            are added.
        external: external forces on bodies.
        gravity: the acceleration of gravity in the world (3,), m/s2.
    """
    bodies = _bodies(tree, geometry, q, v, external, gravity)
    tau = tau + passive_forces(tree, geometry, q, v)
    IA = [body.inertia for body in bodies]
    pA = [body.bias for body in bodies]
    U: dict[int, ForceVector] = {}
    u: dict[int, Scalar] = {}
    per_D: dict[int, Scalar] = {}
    for i in range(len(bodies) - 1, -1, -1):
        link = tree.links[i]
        place = bodies[i].place
        S = bodies[i].S
        Ia = IA[i]
        pa = pA[i]
        if link.kind in ("hinge", "slide"):
            armature = geometry.armature[tree.v_of[i]][0]
            U[i] = IA[i] @ S
            per_D[i] = 1.0 / (S.dot(U[i]) + armature)
            u[i] = tau[tree.v_of[i]][0] - S.dot(pA[i])
            Ia = IA[i].without(U[i], per_D[i])
            pa = pA[i] + U[i] * (u[i] * per_D[i])
            if _is_zero(armature) and _coordinate(place.axis):
                Ia = Ia.freed_along(S)
        if link.parent != WORLD:
            Ia = Ia.rotated(place.across)
            pa = pa.rotated(place.across) + Ia @ bodies[i].c
            IA[link.parent] = IA[link.parent] + Ia.moved_from(place.offset)
            pA[link.parent] = pA[link.parent] + pa.moved_from(place.offset)

    accelerations: list[MotionVector] = []
    pieces: list[Array] = []
    for i, (link, body) in enumerate(zip(tree.links, bodies, strict=True)):
        at = tree.v_of[i]
        if link.kind == "free":
            a, piece = _of_free(body.place, IA[i], pA[i], tau[at], geometry.armature[at], gravity)
            pieces.append(piece)
        else:
            a = _carried(tree, i, bodies, accelerations, gravity)
            if link.kind != "fixed":
                rate = (u[i] - a.dot(U[i])) * per_D[i]
                a = a + body.S * rate
                pieces.append(jnp.reshape(rate, 1))
        accelerations.append(a)
    return jnp.concatenate(pieces)


def passive_forces(
    tree: Tree, geometry: Geometry, q: Float[Array, " nq"], v: Float[Array, " nv"]
) -> Float[Array, " nv"]:
    """Generalised forces (nv,), N m and N, of the joints' dampers and springs.

    Args:
        tree, geometry: the links.
        q, v: positions (nq,) and velocities (nv,).
    """
    springs = []
    for i, link in enumerate(tree.links):
        stretch = q[tree.q_of[i]] - geometry.rest[i]
        springs.append(np.zeros(6) if link.kind == "free" else geometry.stiffness[i] * stretch)
    return -(geometry.damping * v + jnp.concatenate(springs))


def rigid_body(geometry: Geometry, i: int, place: Place) -> tuple[Inertia, Float[Array, " 3"]]:
    """The inertia of link i about its point, and its mass times its centre of mass from there (3,).

    Args:
        geometry: the numbers of the links.
        i: the number of the link.
        place: its place, in whose axes the results are.
    """
    mass = geometry.mass[i]
    c = geometry.com[i] - geometry.anchor[i]
    # computed in the body's frame, where it is constant, and then rotated
    inertia = geometry.inertia[i] + mass * ((c @ c) * EYE - c[:, None] * c[None, :])
    h = place.turn @ (mass * c)
    return Inertia(turned(place.turn, inertia), skew(h), mass * EYE), h


def _bodies(
    tree: Tree, geometry: Geometry, q: Array, v: Array, external: External, gravity: Array
) -> list[_Body]:
    placed = places(tree, geometry, q)
    moving = movements(tree, placed, v)
    for force in external:
        if not 0 <= force.link < len(placed):
            last = len(placed) - 1
            raise ValueError(f"A force acts on link {force.link}, but the tree has links 0 to {last}.")
    bodies = []
    for i, (link, place) in enumerate(zip(tree.links, placed, strict=True)):
        inertia, h = rigid_body(geometry, i, place)
        w = moving[i].angular
        bias = ForceVector(cross(w, inertia.I @ w), cross(w, cross(w, h)))
        for force in external:
            if force.link != i:
                continue
            bias = bias - force.on(place)
            if isinstance(force, YieldingForce):
                yields = force.inertia(place)
                inertia, bias = inertia + yields, bias + yields @ force.at_rest(place, w, gravity)
        S = MotionVector(ZERO, place.axis) if link.kind == "slide" else MotionVector(place.axis, ZERO)
        c = MotionVector(ZERO, ZERO)
        if link.parent != WORLD:
            c = _velocity_product(link.kind, place, moving[link.parent], v[tree.v_of[i]])
        bodies.append(_Body(place, inertia, bias, S, c))
    return bodies


def _velocity_product(kind: str, place: Place, parent: Movement, rate: Array) -> MotionVector:
    """The velocity-product acceleration `c`: centripetal, and Coriolis of the joint's motion."""
    w = parent.angular
    linear = cross(w, cross(w, place.offset))
    if kind == "fixed":
        return MotionVector(ZERO, linear)
    coriolis = cross(w, place.axis_across * rate[0])
    return MotionVector(coriolis, linear) if kind == "hinge" else MotionVector(ZERO, linear + 2.0 * coriolis)


def _carried(
    tree: Tree, i: int, bodies: list[_Body], accelerations: list[MotionVector], gravity: Array
) -> MotionVector:
    """The acceleration of link i at zero joint acceleration; the world has the acceleration -gravity."""
    parent = tree.links[i].parent
    below = MotionVector(ZERO, -gravity) if parent == WORLD else accelerations[parent]
    place = bodies[i].place
    outward = None if place.across is None else place.across.T
    return (below.shifted(place.offset) + bodies[i].c).rotated(outward)


def _of_free(
    place: Place, IA: Inertia, pA: ForceVector, tau: Array, armature: Array, gravity: Array
) -> tuple[MotionVector, Array]:
    """The acceleration of a free link, in its axes and less gravity, and MuJoCo's qacc of its joint (6,)."""
    to_link = place.frame.T
    linear = turned(to_link, EYE * armature[:3, None])
    # armature on linear velocities resists their change, but has no weight
    force = ForceVector(tau[3:], to_link @ tau[:3] - linear @ (to_link @ gravity)) - pA
    upper = jnp.concatenate([IA.I + EYE * armature[3:, None], IA.H], axis=1)
    lower = jnp.concatenate([IA.H.T, IA.M + linear], axis=1)
    a = solve_positive(jnp.concatenate([upper, lower]), jnp.concatenate([force.couple, force.linear]))
    return MotionVector(a[:3], a[3:]), jnp.concatenate([place.frame @ a[3:] + gravity, a[:3]])


def _is_zero(value: Scalar) -> bool:
    """Whether a number is a constant zero; a JAX array never is."""
    return isinstance(value, float | np.generic) and float(value) == 0.0


def _coordinate(axis: Array) -> bool:
    return isinstance(axis, np.ndarray) and bool(np.sum(axis != 0.0) == 1)
