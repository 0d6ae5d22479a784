"""The body of Table I, and its scaling to the masses and lengths of a row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from types import SimpleNamespace
from typing import Any

from gaitsweep.dynamics.tree import Geometry, Tree

LIMBS = range(4)
# The body of Table I, as in the MJCF.
BODY_SIZE = 0.1  # m: length and width of each body, and their distance
BODY_HEIGHT = 0.05  # m
HIP_X, HIP_Y = 0.048, 0.05  # m, from the centre of mass of a body
LINK_MASS, LINK_LENGTH = 0.1, 0.08  # kg, m
# What a body has of its own where its hips and its waist's axis are not level with the centres of mass.
HEIGHT_NAMES = ("front_height", "rear_height", "front_hip_z", "rear_hip_z", "waist_z")


def sizes_of(values: Mapping[str, Any]) -> SimpleNamespace:
    """A row's masses and lengths by name, as `factors` and `displacements` take them."""
    return SimpleNamespace(**{**dict.fromkeys(HEIGHT_NAMES), **values})


def factors(sizes: Any, stack: Callable[[list[Any]], Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The factors of mass and of size of each body and link relative to Table I, by name.

    Args:
        sizes: an object with `front_mass` (kg), `rear_length` (m) and so on, numbers or arrays; HEIGHT_NAMES
            are None in a level body.
        stack: the function that stacks them to an array.
    """

    def factor_of(length: Any, width: Any, height: Any) -> Any:
        level = [length / BODY_SIZE, width / BODY_SIZE]
        upwards = 1.0 if height is None else height / BODY_HEIGHT
        return stack([*level, upwards])

    front = factor_of(sizes.front_length, sizes.front_width, sizes.front_height)
    rear = factor_of(sizes.rear_length, sizes.rear_width, sizes.rear_height)
    links = [f"{part}_{i + 1}" for part in ("upper", "lower") for i in LIMBS]
    mass = {"front": sizes.front_mass, "rear": sizes.rear_mass}  # 1 kg each in Table I
    mass |= dict.fromkeys(links, sizes.link_mass / LINK_MASS)
    return mass, {"front": front, "rear": rear} | dict.fromkeys(links, sizes.link_length / LINK_LENGTH)


def displacements(sizes: Any, stack: Callable[[list[Any]], Any]) -> tuple[dict[str, Any], Any]:
    """Displacements (3,), m, of hips and waist, by link, and of the rear body's centre of mass.

    They are relative to the places that `factors` scales with the bodies, at which all are zero. The rear
    body's frame is at the waist, which is at the end of the front body.

    Args:
        sizes: as for `factors`, with `front_hip_x`, `body_distance` and so on.
        stack: the function that stacks them to an array (3,).
    """
    front_size, rear_size = sizes.front_length / BODY_SIZE, sizes.rear_length / BODY_SIZE
    front_width, rear_width = sizes.front_width / BODY_SIZE, sizes.rear_width / BODY_SIZE
    half = 0.5 * BODY_SIZE
    gap = half * front_size + half * rear_size - sizes.body_distance
    front = sizes.front_hip_x - HIP_X * front_size, sizes.front_hip_y - HIP_Y * front_width
    rear = gap + (HIP_X * rear_size - sizes.rear_hip_x), sizes.rear_hip_y - HIP_Y * rear_width
    if sizes.waist_z is None:  # a level body
        front_z, rear_z, axis = 0.0, 0.0, 0.0
        moved = {}
    else:
        front_z, rear_z, axis = sizes.front_hip_z, sizes.rear_hip_z, sizes.waist_z
        moved = {"rear": stack([0.0, 0.0, axis])}
    for i in LIMBS:
        x, y, z = (*front, front_z) if i < 2 else (*rear, rear_z - axis)
        across = y if i % 2 else -y  # limbs 2 and 4 are on the left
        moved[f"upper_{i + 1}"] = stack([x, across, z])
    return moved, stack([gap, 0.0, -axis])


def mjcf() -> str:
    """The body as an MJCF."""
    return resources.files("gaitsweep.papers.aoi2011.waist_quadruped").joinpath("body.xml").read_text()


@cache
def body() -> tuple[Tree, Geometry]:
    """The tree, and its geometry with the numbers of Table I."""
    from gaitsweep.dynamics.tree import tree_of  # MuJoCo, only for a job of this body

    return tree_of(mjcf())
