"""A biped of an MJCF: it walks, its steps are in antiphase, and its bodies are drawn with their lengths."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.examples.boom_walker import BoomWalker


@pytest.mark.slow
def test_it_walks_forward_on_alternating_legs() -> None:
    """The speed is that of the trunk between crossings, and feet land half a cycle after each other."""
    rows = gs.sweep(BoomWalker(), omega=[5.0, 7.0], run=gs.ReturnMap(crossings=30), verify=0).table
    for _, row in rows.groupby("row"):
        last = row.iloc[-8:]
        assert (last["speed_n"] > 0.1).all()
        # legs in phase would be off by pi
        assert np.abs(last["lag_2_n"] - math.pi).max() < 0.7
        assert last["duty_1_n"].between(0.4, 0.6).all()
        assert last["height_n"].between(-0.05, 0.05).all()


def test_a_longer_leg_is_drawn_longer() -> None:
    """The MJCF of a row has its sizes: of the thigh, the place of the knee, and what hangs on it."""
    walker = BoomWalker()
    values = {q.name: float(q.default) for q in walker.parameters if isinstance(q.default, float | int)}
    plain = mujoco.MjModel.from_xml_string(walker.mjcf(values))
    longer = mujoco.MjModel.from_xml_string(
        walker.mjcf(values | {"thigh_l_size": 1.5, "foot_l_radius": 0.07})
    )
    places = []
    for model in (plain, longer):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        places.append((data.body("shin_l").xpos[2], data.geom("foot_l").xpos[2]))
    np.testing.assert_allclose(np.subtract(*places), 0.5 * 0.42, atol=1e-12)
    np.testing.assert_allclose(longer.geom("thigh_l").size[:2], 1.5 * plain.geom("thigh_l").size[:2])
    assert longer.geom("foot_l").size[0] == pytest.approx(0.07)
    np.testing.assert_allclose(longer.body("shin_r").pos, plain.body("shin_r").pos)
