"""The drawing of the planar quadruped: a box and four telescopic legs."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from gaitsweep import Limb, LimbLook, Skeleton
from gaitsweep.papers.fukuoka2015.planar_quadruped.bodies import edit
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import mjcf
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS

if TYPE_CHECKING:
    import mujoco

NAMES = {"LF": "left fore", "LH": "left hind", "RF": "right fore", "RH": "right hind"}
LIMBS = tuple(LimbLook(NAMES[leg], pair=int(leg[1] == "H"), far=leg[0] == "L") for leg in LEGS)
_CORNERS = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def compiled_spec(values: Mapping[str, float]) -> mujoco.MjSpec:
    """The MJCF with a row's masses and lengths, compiled."""
    import mujoco  # only where a body is drawn

    spec = mujoco.MjSpec.from_string(mjcf())
    edit(spec, values)
    spec.compile()
    return spec


class PlanarDrawing:
    """The members `limbs`, `skeleton` and `mjcf` of a model with this body."""

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        return LIMBS

    def mjcf(self, values: Mapping[str, float]) -> str:
        return compiled_spec(values).to_xml()

    def skeleton(
        self, values: Mapping[str, float], signals: Mapping[str, Float[np.ndarray, " times"]]
    ) -> Skeleton:
        """The parts of the body, by MuJoCo's kinematics.

        Args:
            values: the parameters, with masses and lengths.
            signals: q_0 to q_10, (n,) each.
        """
        import mujoco

        model = compiled_spec(values).compile()
        data = mujoco.MjData(model)
        qpos = np.stack([signals[f"q_{i}"] for i in range(model.nq)], axis=1)
        limbs, boxes = np.empty((len(LEGS), len(qpos), 2, 3)), np.empty((len(qpos), 8, 3))
        torso = model.geom("torso").id
        for k, q in enumerate(qpos):
            data.qpos = q
            mujoco.mj_kinematics(model, data)
            for i, leg in enumerate(LEGS):
                limbs[i, k] = [data.body(f"upper_{leg}").xpos, data.body(f"lower_{leg}").xpos]
            across = data.geom_xmat[torso].reshape(3, 3) * model.geom_size[torso]
            boxes[k] = data.geom_xpos[torso] + _CORNERS @ across.T
        return Skeleton(
            limbs=tuple(Limb(look.name, limbs[i], look.pair, look.far) for i, look in enumerate(LIMBS)),
            bodies=(boxes,),
            note="Each leg slides: its knee is a spring along it.",
        )
