"""Drawings of models: places of limbs and feet, the side of the view, and the point that it follows."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb

import gaitsweep as gs
from gaitsweep import models
from gaitsweep.job import Job
from gaitsweep.plot.limbs import limb_colours, limbs_of_model, model_of
from gaitsweep.skeleton import Skeleton
from gaitsweep.view.movie.animation import Clip, frames, still
from gaitsweep.view.movie.side_view import bounds, heading, turned
from gaitsweep.view.row_motion import read_motion
from tests.support.sweeping import scalars
from tests.support.trace_directories import (
    CYCLE,
    SPEED,
    quadruped_signals,
    quadruped_skeleton,
    quadruped_table,
)


@pytest.mark.parametrize("name", models.names())
def test_registered_models_are_drawn_or_say_that_they_are_not(name: str) -> None:
    model = models.find(name)()
    start = {q.name: 1.0 for q in model.initial_conditions if q.default is None}
    parameters, _ = Job(name="one", model=name, start=start, run={"kind": "settle"}).design.values(0, 1)
    moments = 3
    signals = {q.name: np.linspace(0.9, 1.0, moments) for q in model.signals}
    drawn = model.skeleton({key: float(value[0]) for key, value in parameters.items()}, signals)
    if drawn is None:
        return
    assert isinstance(drawn, Skeleton)
    assert len({limb.name for limb in drawn.limbs}) == len(drawn.limbs) > 0
    table = pd.DataFrame()
    table.attrs["job"] = {"model": name, "structure": {}}
    limbs = limbs_of_model(model_of(table), len(drawn.limbs))
    assert [limb.name for limb in limbs] == [limb.name for limb in drawn.limbs]
    assert limb_colours(limbs) == limb_colours(drawn.limbs)
    assert all(f"contact_{i + 1}" in signals for i in range(len(drawn.limbs)))
    for points in (*(limb.points for limb in drawn.limbs), *drawn.bodies, *drawn.springs):
        assert points.shape[0] == moments
        assert points.shape[2] == 3
        assert np.isfinite(points).all()


def test_feet_are_drawn_where_the_dynamics_has_them() -> None:
    """Two kinematics of one body: MuJoCo's of the scaled MJCF and the tree's, alike but for rounding."""
    lengths = {"front_length": 0.12, "front_width": 0.09, "rear_length": 0.11, "rear_width": 0.08}
    lengths["link_length"] = 0.09
    body = scalars(models.find("waist_quadruped")(), **lengths).mechanics
    signals = quadruped_signals(0.01 * np.arange(81))
    drawn = quadruped_skeleton(**lengths)
    for k in (0, 33, 80):
        q = jnp.asarray([signals[f"q_{i}"][k] for i in range(16)])
        feet, _ = body.feet(q, jnp.zeros(15))
        np.testing.assert_allclose([limb.points[k, -1] for limb in drawn.limbs], feet, atol=1e-12)
    assert drawn.bodies[0][0, :, 0].max() == pytest.approx(0.06)
    assert np.ptp(drawn.bodies[1][0, :, 1]) == pytest.approx(0.08, abs=1e-4)  # rolled by the waist: a cosine


def test_a_body_that_walks_elsewhere_is_seen_from_its_side() -> None:
    ahead, aside = quadruped_skeleton(), quadruped_skeleton(yaw=2.0)
    assert heading(aside) == pytest.approx(2.0, abs=1e-6)
    seen = turned(aside, heading(aside))
    for one, other in zip(ahead.limbs, seen.limbs, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-6)


def test_the_picture_follows_the_body_but_not_its_sway(tmp_path: Path) -> None:
    motion = read_motion(quadruped_table(tmp_path / "trot"), 0)
    assert motion.period == pytest.approx(CYCLE)
    times = np.linspace(0.0, 0.8, 161)
    drawn = motion.model.skeleton(motion.values, motion.at(times))
    assert drawn is not None
    clip = Clip(times, drawn, motion.t, motion.contact(4), motion.period, "")
    # at constant speed its mean over a cycle is where it is, at both ends too
    np.testing.assert_allclose(clip.camera[:, 0], SPEED * times - 0.05, atol=1e-9)
    assert clip.down.shape == (161, 4)
    assert clip.down[3].tolist() == [False, True, True, False]


def test_a_body_without_limbs_is_drawn(tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 21)
    corners = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.0, 0.1], [-0.1, 0.0, 0.1]])
    ball = Skeleton((), bodies=(corners + (t * (1.0 - t))[:, None, None] * [0.0, 0.0, 1.0],))
    height = 0.1 + 0.25  # of the highest corner, at half time
    assert bounds(ball, np.zeros((21, 2))) == pytest.approx((0.1, height, 0.3 * height))
    no_feet = read_motion(quadruped_table(tmp_path / "trot"), 0).contact(0)
    assert no_feet.shape[1] == 0
    clip = Clip(t, ball, np.linspace(0.0, 1.0, len(no_feet)), no_feet, 1.0, "ball")
    shown = {tuple(pixel) for pixel in next(frames(clip, (320, 180))).reshape(-1, 3).tolist()}
    assert tuple(round(255 * part) for part in to_rgb("#DDE0E4")) in shown


@pytest.mark.parametrize("title", ["", "a long title " * 20])
def test_a_frame_has_the_size_that_is_asked_for_in_any_style(title: str) -> None:
    """No warning either: not of the height of a page, and not of a title without details or words."""
    t = np.linspace(0.0, 1.0, 3)
    corners = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.1]])
    clip = Clip(t, Skeleton((), bodies=(np.stack([corners] * 3),)), t, np.zeros((3, 0)), 1.0, title)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        styles: tuple[dict[str, Any], ...] = ({}, {"width": "column"}, {"height": 60})
        for style in styles:
            with gs.plot.style(**style):
                assert next(frames(clip, (180, 320))).shape == (320, 180, 3)
                strip = still(clip, (180, 320))
            assert (strip.bbox.width, strip.bbox.height) == pytest.approx((180, 320))
