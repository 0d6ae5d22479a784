"""The drawing of a body of an MJCF: outlines of its geoms, and limbs down to its sites foot_1, foot_2, ..."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from gaitsweep.skeleton import Limb, LimbLook, Skeleton

_GROUPS = 3  # geoms of groups 0 to 2 are those that MuJoCo's viewer shows; others are for collisions
# Every second point first: an outline that faces the viewer is filled once whole and once by its first half.
_ANGLES = 0.125 * np.pi * np.array([*range(0, 16, 2), *range(1, 16, 2)])
_CIRCLE = np.stack([np.cos(_ANGLES), np.zeros(len(_ANGLES)), np.sin(_ANGLES)], axis=1)
_AROUND = np.array([at for at in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(at)])
_CORNERS = _AROUND[np.abs(_AROUND).sum(axis=1) == 3]


def skeleton(
    model: Any, signals: Mapping[str, Float[np.ndarray, " times"]], feet: int, looks: Sequence[LimbLook] = ()
) -> Skeleton:
    """The geoms of a body, and its limbs if it has a site for each foot.

    Args:
        model: the compiled MJCF.
        signals: q_0, q_1, ..., MuJoCo's qpos, (n,) each.
        feet: number of signals contact_1, contact_2, ...
        looks: names and places of the limbs; by default they have numbers.
    """
    data = mujoco.MjData(model)
    qpos = np.stack([signals[f"q_{i}"] for i in range(model.nq)], axis=1)
    outlines = {geom: _outline(model, geom) for geom in _drawn(model)}
    bodies = {geom: np.empty((len(qpos), len(a) * len(b), 3)) for geom, (a, b) in outlines.items()}
    sites = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"foot_{i + 1}") for i in range(feet)]
    chains = [] if -1 in sites else [_chain(model, int(model.site_bodyid[site])) for site in sites]
    limbs = [np.empty((len(qpos), len(chain) + 1, 3)) for chain in chains]
    for k, q in enumerate(qpos):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        for geom, (own, facing) in outlines.items():
            places = data.geom_xpos[geom] + own @ data.geom_xmat[geom].reshape(3, 3).T
            bodies[geom][k] = (facing[:, None] + places).reshape(-1, 3)
        for chain, site, limb in zip(chains, sites, limbs, strict=False):
            limb[k] = [*data.xpos[chain], data.site_xpos[site]]
    mujoco.mj_resetData(model, data)
    mujoco.mj_kinematics(model, data)
    aside = [float(data.site_xpos[site][1]) for site in sites[: len(limbs)]]
    numbered = looks_of_feet([f"leg {i + 1}" for i in range(len(limbs))], aside)
    named = looks if len(looks) == len(limbs) else numbered
    return Skeleton(
        limbs=tuple(
            Limb(look.name, limb, pair=look.pair, far=look.far)
            for look, limb in zip(named, limbs, strict=True)
        ),
        bodies=tuple(bodies.values()),
        heading=0.0,
    )


def looks_of_feet(names: Sequence[str], aside: Sequence[float]) -> tuple[LimbLook, ...]:
    """Names and places of limbs, each two a pair, from the places (m) of their feet to the left."""
    rounded = [round(place, 9) for place in aside]
    return tuple(LimbLook(name, i // 2, _is_far(rounded, i)) for i, name in enumerate(names))


def _is_far(aside: list[float], i: int) -> bool:
    """Whether limb i is the left one of its pair, or the second where both are in one plane."""
    other = min(i ^ 1, len(aside) - 1)
    return (aside[i], i) > (aside[other], other)


def _drawn(model: Any) -> list[int]:
    """The geoms of moving bodies that MuJoCo's viewer shows; all of them if it shows none."""
    flat = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    moving = (model.body_weldid[model.geom_bodyid] > 0) & ~np.isin(model.geom_type, flat)
    shown = moving & (model.geom_group < _GROUPS) & (model.geom_rgba[:, 3] > 0.0)
    return np.flatnonzero(shown if shown.any() else moving).tolist()


def _outline(model: Any, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a geom: places (m, 3) in its frame, and offsets (k, 3) from each that face the viewer, m."""
    kind = int(model.geom_type[geom])
    size = model.geom_size[geom]
    still = np.zeros((1, 3))
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_SPHERE:
        return still, size[0] * _CIRCLE
    if kind == shapes.mjGEOM_CAPSULE:
        return np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), size[0] * _CIRCLE
    if kind == shapes.mjGEOM_CYLINDER:
        ring = size[0] * _CIRCLE[:, [0, 2, 1]]
        end = np.array([0.0, 0.0, size[1]])
        return np.concatenate([ring - end, ring + end]), still
    if kind == shapes.mjGEOM_ELLIPSOID:
        return size * _AROUND / np.linalg.norm(_AROUND, axis=1, keepdims=True), still
    if kind == shapes.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        count = int(model.mesh_vertnum[mesh])
        points = np.asarray(model.mesh_vert[first : first + count], float)
        return points[np.argmax(_AROUND @ points.T, axis=1)], still  # the farthest in each direction
    return size * _CORNERS, still


def _chain(model: Any, body: int) -> list[int]:
    """The bodies from the one below the tree's root down to `body`; the root alone if there is no other."""
    chain = [body]
    while model.body_parentid[chain[0]] > 0:
        chain.insert(0, int(model.body_parentid[chain[0]]))
    return chain[1:] or chain
