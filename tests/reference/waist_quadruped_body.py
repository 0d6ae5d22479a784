"""The quadruped with a waist joint as an MjModel of other masses and lengths, from its page alone.

Boxes of m_B, l_B x w_B x h_B; rods of m_L and l_L; the waist at the end of the front body; hips where they
are given, else where the MJCF has them, in proportion.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np


def varied(xml: str, values: Mapping[str, float]) -> mujoco.MjModel:
    """The body with `link_mass` (kg), `link_length` (m), `g`, and masses and sizes of both its bodies.

    `front_mass`, `rear_length` and so on; where they are left out, `body_mass`, `body_length`, `body_width`.
    `front_hip_x`, `rear_hip_y`, `body_distance` and so on may be left out, and so may all heights.
    """
    spec = mujoco.MjSpec.from_string(xml)
    link, length = values["link_mass"], values["link_length"]
    rod = link * length**2 * np.array([1.0 / 12.0, 1.0 / 12.0, 1e-6 / (0.1 * 0.08**2)])
    trunks = {}
    for name in ("front", "rear"):
        parts = ("mass", "length", "width")
        owners = (name if f"{name}_{part}" in values else "body" for part in parts)
        mass, long, wide = (values[f"{owner}_{part}"] for owner, part in zip(owners, parts, strict=True))
        high = values.get(f"{name}_height", 0.05)
        box = mass / 12.0 * np.array([wide**2 + high**2, long**2 + high**2, long**2 + wide**2])
        trunks[name] = mass, box, np.array([long / 0.1, wide / 0.1, 1.0])
    for body in spec.bodies[1:]:
        if body.name in trunks:
            mass, box, trunk = trunks[body.name]
            body.mass, body.inertia, body.ipos = mass, box, trunk * body.ipos
            if body.name == "rear":  # the waist is at the end of the front body
                body.pos = trunks["front"][2] * body.pos
            continue
        body.mass, body.inertia, body.ipos = link, rod, [0.0, 0.0, -0.5 * length]
        carrier = "front" if body.name[-1] in "12" else "rear"
        body.pos = trunks[carrier][2] * body.pos if body.name.startswith("upper") else [0.0, 0.0, -length]
        for site in body.sites:
            site.pos = [0.0, 0.0, -length]
    if "body_distance" in values:
        behind = values["body_distance"] - 0.5 * (values["front_length"] / 0.1) * 0.1
        axis = values.get("waist_z", 0.0)
        spec.body("rear").pos[2], spec.body("rear").ipos = axis, [-behind, 0.0, -axis]
        for number, side in ((1, -1), (2, 1), (3, -1), (4, 1)):
            name = "front" if number < 3 else "rear"
            x = values["front_hip_x"] if number < 3 else -behind - values["rear_hip_x"]
            z = values.get(f"{name}_hip_z", 0.0) - (axis if name == "rear" else 0.0)
            spec.body(f"upper_{number}").pos = [x, side * values[f"{name}_hip_y"], z]
    spec.option.gravity = [0.0, 0.0, -values["g"]]
    return spec.compile()
