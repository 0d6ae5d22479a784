"""The ball on a shaking table: its atlas against closed forms (Luck and Mehta 1993, Phys. Rev. E 48:3988)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.examples.bouncing_ball import BouncingBall
from gaitsweep.job import JobError

RANGES = {"phase_0": (0.0, 2.0 * np.pi), "speed_0": (0.0, 6.0)}


def fold(n: Any, restitution: Any) -> Any:
    """Return the table's acceleration from which on the ball stays in flight for n periods of the table."""
    return n * np.pi * (1.0 - restitution) / (1.0 + restitution)


def flip(n: Any, restitution: Any) -> Any:
    """Return the acceleration from which on two bounces differ."""
    doubled = 2.0 * (1.0 + restitution**2) / (1.0 + restitution) ** 2
    return np.sqrt(fold(n, restitution) ** 2 + doubled**2)


@pytest.mark.slow
def test_an_atlas_has_the_folds_and_flips_of_both_gaits_to_1e_9() -> None:
    """At G = 2.2 the ball has gaits of one period of the table and of two, stable and unstable ones."""
    ball = gs.atlas(
        BouncingBall(), parameter="G", path=(1.0, 2.5), at=2.2, ranges=RANGES, periods=1, depth=0, budget=192,
        second={"restitution": (0.4, 0.6)}, verify=0,
    )  # fmt: skip
    points = ball.points
    table = points.assign(n=np.round(points["time"] / (2.0 * np.pi))).sort_values("G")
    assert table["special"].tolist() == ["fold", "flip", "fold", "flip"]
    assert table["n"].tolist() == [1, 1, 2, 2]
    exact = [fold(1, 0.5), flip(1, 0.5), fold(2, 0.5), flip(2, 0.5)]
    np.testing.assert_allclose(table["G"], exact, atol=1e-9)
    np.testing.assert_allclose(exact, [1.0471975512, 1.5268237005, 2.0943951024, 2.3708772103], atol=1e-10)
    gaits = ball.gaits
    assert np.sum(gaits["stable"].to_numpy(bool)) == 1  # of two periods; that of one has flipped
    assert len(gaits) == 4
    n = np.round(gaits["time"] / (2.0 * np.pi))
    cosines = fold(n, 0.5) / 2.2
    np.testing.assert_allclose(np.cos(gaits["phase_n"]), cosines, atol=1e-10)
    assert np.max(gaits["error"].to_numpy(float)) < 1e-9
    curves = ball.curves
    n = np.round(curves["time"].to_numpy(float) / (2.0 * np.pi))
    restitution = curves["restitution"].to_numpy(float)
    folds = (curves["part"] == "fold").to_numpy(bool)
    expected = np.where(folds, fold(n, restitution), flip(n, restitution))
    np.testing.assert_allclose(curves["G"], expected, atol=1e-9)
    for number, curve in curves.groupby("number"):
        assert set(curve["end"].astype(str)) - {""} == {"range"}, number
    assert len(ball.plot.road_map(y="phase").axes) == 1
    assert len(ball.plot.atlas().axes) == 1


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"at": 3.0}, ["run.at is 3", "from 1 to 2"]),
        ({"ranges": {"speed": (0.0, 6.0), "phase_O": (0.0, 1.0)}}, ["phase_O", "did you mean phase_0"]),
        ({"ranges": {"speed": (6.0, 0.0)}}, ["run.ranges.speed", "from 6 to 0"]),
        ({"second": {"G": (1.0, 2.0)}}, ["run.second.G", "another parameter"]),
        ({"path": (2.0, 1.0)}, ["run.path", "above 2"]),
    ],
)
def test_wrong_fields_are_refused(fields: dict[str, Any], words: list[str]) -> None:
    given: dict[str, Any] = {"parameter": "G", "path": (1.0, 2.0), "ranges": RANGES, **fields}
    with pytest.raises(JobError) as error:
        gs.atlas(BouncingBall(), **given)
    assert all(word in str(error.value) for word in words), str(error.value)


@pytest.mark.slow
def test_a_row_without_a_gait_keeps_its_record() -> None:
    """Below the fold there is no gait that keeps the table's period."""
    ball = gs.atlas(
        BouncingBall(), parameter="G", path=(0.5, 0.9), at=0.7, ranges=RANGES, periods=1, depth=0, budget=64,
    )  # fmt: skip
    assert len(ball.gaits) == 0
    table = ball.table
    assert set(table.columns) - {"row"} <= set(table.attrs["quantities"])
    assert len(gs.Atlas(table).gaits) == 0
    with pytest.raises(gs.ArgumentError, match="lacks found, special of a run of kind atlas"):
        gs.Atlas(table.drop(columns=["found", "special"]))
    without_job = table.copy()
    without_job.attrs = {}
    with pytest.raises(gs.ArgumentError, match=r"no job in its \.attrs"):
        gs.Atlas(without_job)
    assert ball.table["status"].tolist() == ["no_fixed_point"]
    assert ball.table["end"].tolist() == ball.more().table["end"].tolist() == ["no_gait"]
