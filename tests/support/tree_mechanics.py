"""Mechanics of an articulated tree that tests compare with MuJoCo: inverse dynamics, energy, momentum."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitsweep.dynamics.tree.articulated_tree import WORLD, Geometry, Tree
from gaitsweep.dynamics.tree.dynamics import _bodies, _carried, passive_forces, rigid_body
from gaitsweep.dynamics.tree.kinematics import Place, movements, places, velocity
from gaitsweep.dynamics.tree.spatial import EYE, ZERO, Array, ForceVector, MotionVector, Scalar, cross, turned


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class WorldForce:
    """A spatial force in world coordinates.

    `link` is the link's number; `couple` (3,) N m is about the world's origin; `force` (3,) N.
    """

    link: int = dataclasses.field(metadata={"static": True})
    couple: Array
    force: Array

    def on(self, place: Place) -> ForceVector:
        """The spatial force about the link's point, in the link's axes."""
        couple = self.couple - cross((place.base + place.frame @ place.reach), self.force)
        return ForceVector(place.frame.T @ couple, place.frame.T @ self.force)


def inverse_dynamics(
    tree: Tree,
    geometry: Geometry,
    q: Array,
    v: Array,
    acceleration: Array,
    external: Sequence[Any] = (),
    *,
    gravity: Array,
) -> Array:
    """Generalised forces tau (nv,), N m and N, of an `acceleration` (nv,), by Newton-Euler (table 5.1).

    The inverse of `forward_dynamics`, with its arguments.
    """
    bodies = _bodies(tree, geometry, q, v, external, gravity)
    accelerations: list[MotionVector] = []
    forces: list[ForceVector] = []
    for i, (link, body) in enumerate(zip(tree.links, bodies, strict=True)):
        rate = acceleration[tree.v_of[i]]
        if link.kind == "free":
            a = MotionVector(rate[3:], body.place.frame.T @ (rate[:3] - gravity))
        else:
            a = _carried(tree, i, bodies, accelerations, gravity)
            a = a if link.kind == "fixed" else a + body.S * rate[0]
        accelerations.append(a)
        forces.append(body.inertia @ a + body.bias)

    pieces: list[Array] = []
    for i in range(len(bodies) - 1, -1, -1):
        link, place = tree.links[i], bodies[i].place
        if link.kind == "free":
            pieces += [forces[i].couple, place.frame @ forces[i].linear]
        elif link.kind != "fixed":
            pieces.append(jnp.reshape(bodies[i].S.dot(forces[i]), 1))
        if link.parent != WORLD:
            felt = forces[i].rotated(place.across).moved_from(place.offset)
            forces[link.parent] = forces[link.parent] + felt
    tau = jnp.concatenate(pieces[::-1])
    return tau + geometry.armature * acceleration - passive_forces(tree, geometry, q, v)


def mass_matrix(tree: Tree, geometry: Geometry, q: Array) -> Array:
    """The mass matrix (nv, nv), kg m2, kg m and kg, with armature, by composite bodies (table 6.2).

    Args:
        tree, geometry: the links.
        q: positions (nq,).
    """
    placed = places(tree, geometry, q)
    composite = [rigid_body(geometry, i, place)[0] for i, place in enumerate(placed)]
    rows = [
        [geometry.armature[k] if k == j else np.float64(0.0) for j in range(tree.nv)] for k in range(tree.nv)
    ]
    for i in range(len(placed) - 1, -1, -1):
        for k, S_k in _subspace(tree, i, placed[i]):
            force, j = composite[i] @ S_k, i
            while True:
                for m, S_m in _subspace(tree, j, placed[j]):
                    if m <= k:
                        rows[m][k] = rows[m][k] + S_m.dot(force)
                        rows[k][m] = rows[m][k]
                if tree.links[j].parent == WORLD:
                    break
                force = force.rotated(placed[j].across).moved_from(placed[j].offset)
                j = tree.links[j].parent
        if tree.links[i].parent != WORLD:
            felt = composite[i].rotated(placed[i].across).moved_from(placed[i].offset)
            composite[tree.links[i].parent] = composite[tree.links[i].parent] + felt
    return jnp.array(rows)


def _subspace(tree: Tree, i: int, place: Place) -> list[tuple[int, MotionVector]]:
    """The degrees of freedom of a link's joint, and the motion subspace of each in the link's axes."""
    first = tree.v_of[i].start
    kind = tree.links[i].kind
    if kind == "free":
        linear = [(first + k, MotionVector(ZERO, place.frame.T @ EYE[k])) for k in range(3)]
        return linear + [(first + 3 + k, MotionVector(EYE[k], ZERO)) for k in range(3)]
    if kind == "fixed":
        return []
    return [(first, MotionVector(place.axis, ZERO) if kind == "hinge" else MotionVector(ZERO, place.axis))]


def kinetic_energy(tree: Tree, geometry: Geometry, q: Array, v: Array) -> Scalar:
    """The kinetic energy, J, with that of the armature (eq. 2.67), at q (nq,) and v (nv,)."""
    placed = places(tree, geometry, q)
    total = 0.5 * (geometry.armature @ (v * v))
    for i, (place, moving) in enumerate(zip(placed, movements(tree, placed, v), strict=True)):
        w, speed = moving.angular, velocity(place, moving, geometry.com[i])
        spin = w @ turned(place.turn, geometry.inertia[i]) @ w
        total = total + 0.5 * (geometry.mass[i] * (speed @ speed) + spin)
    return total


def potential_energy(tree: Tree, geometry: Geometry, q: Array, *, gravity: Array) -> Scalar:
    """The potential energy, J, of masses in `gravity` (3,), m/s2, and of joint springs, at q (nq,)."""
    total: Scalar = 0.0
    for i, place in enumerate(places(tree, geometry, q)):
        total = total - geometry.mass[i] * (gravity @ place.position(geometry.com[i]))
        if tree.links[i].kind in ("hinge", "slide"):
            stretch = q[tree.q_of[i]][0] - geometry.rest[i]
            total = total + 0.5 * geometry.stiffness[i] * stretch * stretch
    return total


def centre_of_mass(tree: Tree, geometry: Geometry, q: Array) -> Array:
    """The centre of mass of all links in the world (3,), m, at q (nq,)."""
    moment = sum(
        geometry.mass[i] * place.position(geometry.com[i])
        for i, place in enumerate(places(tree, geometry, q))
    )
    return moment / jnp.sum(geometry.mass)


def momentum(tree: Tree, geometry: Geometry, q: Array, v: Array) -> tuple[Array, Array]:
    """Linear momentum (3,), kg m/s, and angular about the centre of mass (3,), kg m2/s, in the world.

    The armature is not included, since it does not belong to the bodies.
    """
    placed = places(tree, geometry, q)
    centre = centre_of_mass(tree, geometry, q)
    linear, angular = ZERO, ZERO
    for i, (place, moving) in enumerate(zip(placed, movements(tree, placed, v), strict=True)):
        p = geometry.mass[i] * velocity(place, moving, geometry.com[i])
        spin = place.frame @ turned(place.turn, geometry.inertia[i]) @ moving.angular
        linear = linear + p
        angular = angular + cross(place.position(geometry.com[i]) - centre, p) + spin
    return linear, angular
