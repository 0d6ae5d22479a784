"""The MJCF of a located body with other lengths, for drawings."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from gaitsweep.dynamics.body.mechanics import LocatedBody


def edited_mjcf(xml: str, body: LocatedBody, values: Mapping[str, float]) -> str:
    """The MJCF with the lengths and places of some values; those that `values` lacks are the file's."""
    defaults = {quantity.name: quantity.default for quantity in body.parameters}
    changed = {n for n, value in values.items() if n in defaults and value != defaults[n]}
    if not any(name.endswith(("_size", "_radius", "_x", "_y", "_z")) for name in changed):
        return xml
    spec = mujoco.MjSpec.from_string(xml)
    spec.compile()
    sizes = {0: 1.0}
    for part in spec.bodies:
        if part.id == 0:
            continue
        name, size = body.name_of_body(part.id), values.get(f"{body.name_of_body(part.id)}_size", 1.0)
        sizes[part.id] = size
        place = [values.get(f"{name}_{axis}", x) for axis, x in zip("xyz", part.pos, strict=True)]
        part.pos = sizes[part.parent.id] * np.array(place)
        for joint in part.joints:
            joint.pos = size * joint.pos
        for site in part.sites:
            site.pos = size * site.pos
        for geom in part.geoms:
            radius = values.get(f"{body.name_of_geom(geom.id)}_radius", geom.size[0])
            geom.size = size * np.array([radius, *geom.size[1:]])
            geom.pos = size * geom.pos
            geom.fromto = size * geom.fromto
    return spec.to_xml()
