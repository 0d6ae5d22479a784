"""The drawing of a body of an MJCF: its outlines are those of its geoms wherever it moves."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import mujoco
import numpy as np

from gaitsweep.dynamics.mjcf_drawing import skeleton
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.skeleton import LimbLook

BODY = """
<mujoco><worldbody>
  <geom type="plane" size="1 1 .1"/> <geom type="box" size="9 9 9" pos="0 0 -9"/>
  <body name="trunk" pos="0 0 1"> <joint type="slide" axis="1 0 0"/> <joint type="hinge" axis="0 1 0"/>
    <geom name="box" type="box" size=".3 .2 .1"/>
    <geom name="sphere" type="sphere" size=".07" pos=".3 0 .1"/>
    <geom name="hidden" type="box" size=".5 .5 .5" group="3"/>
    <body name="thigh" pos="-.2 0 -.1"> <joint type="hinge" axis="0 1 0"/>
      <geom name="capsule" type="capsule" size=".04" fromto="0 0 0 0 0 -.4"/>
      <geom name="cylinder" type="cylinder" size=".05 .02" pos="0 0 -.2"/>
      <geom name="ellipsoid" type="ellipsoid" size=".05 .02 .1" pos=".1 0 -.2"/>
      <site name="foot_1" pos="0 0 -.44"/>
    </body>
  </body>
</worldbody></mujoco>"""
NAMES = ("box", "sphere", "capsule", "cylinder", "ellipsoid")


def test_outlines_follow_the_geoms() -> None:
    """The extent along x and z is the closed form's; an octagon may lack a part of its circle."""
    model = mujoco.MjModel.from_xml_string(BODY)
    qpos = np.random.default_rng(0).uniform(-1.0, 1.0, (12, model.nq))
    drawn = skeleton(model, {f"q_{i}": qpos[:, i] for i in range(model.nq)}, feet=1)
    assert len(drawn.bodies) == len(NAMES)
    data = mujoco.MjData(model)
    for k, q in enumerate(qpos):
        data.qpos = q
        mujoco.mj_forward(model, data)
        for name, body in zip(NAMES, drawn.bodies, strict=True):
            turn, size = data.geom(name).xmat.reshape(3, 3), model.geom(name).size
            half = {
                "box": np.abs(turn) @ size,
                "sphere": np.full(3, size[0]),
                "capsule": np.abs(turn[:, 2]) * size[1] + size[0],
                "cylinder": np.abs(turn[:, 2]) * size[1] + size[0] * np.sqrt(1.0 - turn[:, 2] ** 2),
                "ellipsoid": np.linalg.norm(turn * size, axis=1),
            }[name]
            result = np.abs(body[k] - data.geom(name).xpos).max(axis=0)[[0, 2]]
            cut = 0.0 if name == "box" else (1.0 - np.cos(np.pi / 8.0)) * 2.0
            assert (result <= half[[0, 2]] + 1e-12).all(), name
            assert (result >= (1.0 - cut) * half[[0, 2]] - 1e-12).all(), name
        np.testing.assert_allclose(
            drawn.limbs[0].points[k], [data.body("thigh").xpos, data.site("foot_1").xpos]
        )


def test_a_body_without_a_site_for_each_foot_has_no_limbs() -> None:
    model = mujoco.MjModel.from_xml_string(BODY)
    signals = {f"q_{i}": np.zeros(2) for i in range(model.nq)}
    assert skeleton(model, signals, feet=2).limbs == ()
    (numbered,) = skeleton(model, signals, feet=1).limbs
    (named,) = skeleton(model, signals, feet=1, looks=[LimbLook("LF", 1, far=True)]).limbs
    assert (numbered.name, named.name, named.pair, named.far) == ("leg 1", "LF", 1, True)


def test_the_left_limb_of_a_pair_is_the_far_one() -> None:
    """Limbs of a pair have two lightnesses, in the plane too; the far one is on the left (y > 0)."""
    for aside, far in (((-0.1, 0.1), [False, True]), ((0.1, -0.1), [True, False]), ((0, 0), [False, True])):
        legs = "".join(
            f'<body pos="0 {y} 0"><joint type="hinge" axis="0 1 0"/><geom size=".1"/>'
            f'<site name="foot_{i + 1}"/></body>'
            for i, y in enumerate(aside)
        )
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{legs}</worldbody></mujoco>")
        limbs = skeleton(model, {f"q_{i}": np.zeros(2) for i in range(model.nq)}, feet=2).limbs
        assert [limb.far for limb in limbs] == far
        assert len(set(limb_colours(limbs))) == 2
        assert [limb.name for limb in limbs] == ["leg 1", "leg 2"]
        looks = (LimbLook("LF", 0, far=True), LimbLook("RF", 0))
        named = skeleton(model, {f"q_{i}": np.zeros(2) for i in range(model.nq)}, 2, looks).limbs
        assert [(limb.name, limb.far) for limb in named] == [("LF", True), ("RF", False)]
