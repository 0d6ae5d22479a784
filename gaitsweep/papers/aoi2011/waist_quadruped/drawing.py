"""The drawing of the quadruped: two boxes with the waist's spring between them, four limbs of two links."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from gaitsweep import Limb, LimbLook, Skeleton
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS, displacements, factors, mjcf, sizes_of

NAMES = ("right fore", "left fore", "right hind", "left hind")
LOOKS = tuple(LimbLook(name, pair=i // 2, far=bool(i % 2)) for i, name in enumerate(NAMES))
# Where a box ends towards the waist, in halves of its size: short of it, so that the spring is visible.
_GAP = 0.75
# Corners of the boxes, in halves of their sizes.
_FRONT = np.array([(x, y, z) for x in (-_GAP, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_REAR = _FRONT * [-1.0, 1.0, 1.0]


def _change(
    element: ElementTree.Element,
    key: str,
    factor: Float[np.ndarray, " numbers"] | float = 1.0,
    displacement: Float[np.ndarray, " numbers"] | float = 0.0,
) -> None:
    """Scale the numbers of an attribute and add a displacement (m), without rounding their text."""
    numbers = np.array(element.attrib[key].split(), float) * factor + displacement
    element.set(key, " ".join(repr(float(number)) for number in numbers))


class WaistDrawing:
    """The members `limbs`, `skeleton` and `mjcf` of a model with this body."""

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        return LOOKS

    def mjcf(self, values: Mapping[str, float]) -> str:
        """The MJCF with a row's lengths and hips, as in `WaistMechanics.geometry`, and Table I's masses.

        Args:
            values: `front_length`, `rear_width`, `link_length`, `front_hip_x` and so on, m, among others.
        """
        sizes = sizes_of(values)
        moved_by_body, centre = displacements(sizes, np.array)
        _, factor_by_body = factors(sizes, np.array)
        root = ElementTree.fromstring(mjcf())
        link_factor = np.full(3, factor_by_body["upper_1"])
        for geom in root.findall("default//geom[@fromto]"):
            _change(geom, "fromto", factor=np.tile(link_factor, 2))
        for body in root.iter("body"):
            body_factor = factor_by_body.get(str(body.get("name")), link_factor) * np.ones(3)
            for part in body:
                if part.get("pos"):
                    _change(part, "pos", factor=body_factor)
                if part.get("type") == "box":
                    _change(part, "size", factor=body_factor)
            if (displacement := moved_by_body.get(str(body.get("name")))) is not None:
                _change(body, "pos", displacement=displacement)
            if body.get("name") == "rear":
                for part in (*body.findall("inertial"), *body.findall("geom")):
                    _change(part, "pos", displacement=centre)
        return ElementTree.tostring(root, encoding="unicode")

    def skeleton(
        self, values: Mapping[str, float], signals: Mapping[str, Float[np.ndarray, " times"]]
    ) -> Skeleton:
        """The parts of the body, by MuJoCo's kinematics.

        Args:
            values: the parameters, as for `mjcf`.
            signals: q_0 to q_15, (n,) each.
        """
        import mujoco  # only where a body is drawn

        model = mujoco.MjModel.from_xml_string(self.mjcf(values))
        data = mujoco.MjData(model)
        qpos = np.stack([signals[f"q_{i}"] for i in range(model.nq)], axis=1)
        limbs = np.empty((len(LIMBS), len(qpos), 3, 3))
        boxes = np.empty((2, len(qpos), 8, 3))
        waist = np.empty((len(qpos), 2, 3))
        # ends of the waist's spring in the frames of the boxes
        ends = [[-_GAP, 0.0, 0.0], [_GAP, 0.0, 0.0]]
        geoms = [int(model.body(name).geomadr[0]) for name in ("front", "rear")]
        for k, q in enumerate(qpos):
            data.qpos = q
            mujoco.mj_kinematics(model, data)
            for i in LIMBS:
                hip, knee = data.body(f"upper_{i + 1}").xpos, data.body(f"lower_{i + 1}").xpos
                limbs[i, k] = [hip, knee, data.site(f"foot_{i + 1}").xpos]
            for side, (geom, corners) in enumerate(zip(geoms, (_FRONT, _REAR), strict=True)):
                across = data.geom_xmat[geom].reshape(3, 3) * model.geom_size[geom]
                boxes[side, k] = data.geom_xpos[geom] + corners @ across.T
                waist[k, side] = data.geom_xpos[geom] + across @ ends[side]
        return Skeleton(
            limbs=tuple(Limb(look.name, limbs[i], look.pair, look.far) for i, look in enumerate(LOOKS)),
            bodies=(boxes[0], boxes[1]),
            springs=(waist,),
            note="The waist between its two bodies is a sprung roll joint.",
        )
