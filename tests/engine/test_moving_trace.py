"""Traces along which a parameter moves: the motion of a ramp, sampled in time, and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.engine.recorders.parameter_schedules import RampSchedule
from gaitsweep.job import Job
from tests.support.job_files import refused, written
from toy_model import Toy

TOY = f"{Toy.__module__}:{Toy.__name__}"
WAY: dict[str, Any] = {"parameter": "kick", "path": [0.5, 2.0, 0.5], "rate": 0.1, "initial_dwell": 3}
TEXT = "name: a\nmodel: toy_model:Toy\nvary: {{launch_1: [1, 2]}}\nrun: {run}\n"


def _table(tmp_path: Path, name: str, run: dict[str, Any]) -> Any:
    job = Job(name=name, model=TOY, params={"restitution": 0.5}, vary={"launch_1": [1.0, 2.0]}, run=run)
    return gs.load(gs.run(job, tmp_path / name).path)


@pytest.mark.slow
def test_a_trace_moves_as_the_ramp_does(tmp_path: Path) -> None:
    ramp = _table(tmp_path, "ramp", {"kind": "ramp", **WAY})
    trace = _table(tmp_path, "trace", {"kind": "trace", "duration": 30, "every": 0.01, **WAY})
    assert list(trace.columns[:5]) == ["row", "launch_1", "pass", "kick", "t"]
    way = RampSchedule(tuple(WAY["path"]), WAY["rate"], WAY["initial_dwell"])
    np.testing.assert_allclose(trace["kick"], np.asarray(way.at(trace["t"].to_numpy())), atol=1e-12)
    assert set(trace["pass"]) == {0, 1}
    for row in (0, 1):
        mine, crossed = trace[trace["row"] == row], ramp[(ramp["row"] == row) & (ramp["crossing"] > 0)]
        t, height, speed = (mine[name].to_numpy() for name in ("t", "height_1", "speed_1"))
        # between two samples around a bounce the mass turns from falling to rising
        bounces = np.flatnonzero((speed[:-1] < 0.0) & (speed[1:] > 0.0))
        crossed = crossed.loc[crossed["t"] < t[-1], "t"].to_numpy()
        assert len(bounces) == len(crossed)
        assert np.all((t[bounces] <= crossed + 1e-9) & (crossed <= t[bounces + 1] + 1e-9))
        # a bounce's launch speed rises with the kick, and so does the height after it
        fast, slow = height[(t > 15) & (t < 20)].max(), height[t < 3].max()
        assert fast > 1.5 * slow


def test_a_trace_without_a_moving_parameter_keeps_its_hash() -> None:
    plain = Job(name="a", model=TOY, run={"kind": "trace", "duration": 1, "every": 0.1})
    resolved = plain.resolved()
    assert resolved["run"]["parameter"] is None
    moving = Job(name="a", model=TOY, run={"kind": "trace", "duration": 1, "every": 0.1, **WAY})
    assert moving.hash() != plain.hash()
    assert Job(**resolved).hash() == plain.hash()
    assert Job(**moving.resolved()).hash() == moving.hash()
    assert "kick" not in moving.resolved()["params"]


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ("{kind: trace, duration: 3, every: 1, path: [1, 2]}", ["run.path", "run.parameter"]),
        (
            "{kind: trace, duration: 3, every: 1, parameter: kick}",
            ["run.path is missing", "run.rate is missing", "run.parameter is kick"],
        ),
        ("{kind: trace, duration: 3, every: 1, parameter: kick, path: [1, 2]}", ["run.rate is missing"]),
        (
            "{kind: trace, duration: 3, every: 1, parameter: kick, path: [1, 2], rate: 1, after_cycles: 4}",
            ["run.after_cycles is 4", "use run.initial_dwell"],
        ),
        (
            "{kind: trace, duration: 3, every: 1, parameter: kik, path: [1, 2], rate: 1}",
            ["run.parameter is kik", "did you mean kick?"],
        ),
        (
            "{kind: trace, duration: 3, every: 1, parameter: kick, path: [1, -2], rate: 1}",
            ["run.path[1] is -2", "must be"],
        ),
    ],
)
def test_refusals(tmp_path: Path, run: str, words: list[str]) -> None:
    message = refused(written(tmp_path, TEXT.format(run=run)))
    for word in words:
        assert word in message


def test_a_ramp_of_gaits_needs_something_that_moves(tmp_path: Path) -> None:
    text = TEXT.format(run="{kind: trace, duration: 3, every: 1}") + "figures: [{kind: gait_ramp}]\n"
    assert "no parameter moves" in refused(written(tmp_path, text))


class Tank(gs.DeclaredModel):
    """A level that rises at the cube of an inflow, so along a ramp of the inflow as its fourth power."""

    inflow = gs.parameter("1/s", "inflow", 0.0)
    level = gs.variable("1", "level", 0.0)
    clock = gs.variable("s", "clock", 0.0)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"level": p.inflow**3, "clock": 1.0}

    @gs.event("ticks", section=True)
    def ticks(self, p: Any, s: Any) -> Any:
        return s.clock - 1.0

    @ticks.jump
    def begin(self, p: Any, s: Any) -> Any:
        return s.replace(clock=0.0)

    def period(self, p: Any) -> Any:
        return jnp.ones(())


@pytest.mark.slow
def test_the_error_of_a_moving_parameter_follows_from_the_longest_step() -> None:
    """Tolerances do not lower it; the self-check shows most of it."""
    ramp = {"kind": "ramp", "parameter": "inflow", "path": [0.0, 10.0], "rate": 1.0}

    def error(verify: int = 0, **numerics: Any) -> tuple[float, pd.DataFrame]:
        table = gs.sweep(Tank(), run=ramp, numerics={"method": "tsit5", **numerics}, verify=verify).table
        return float(np.abs(table["level_n"] - table["t"] ** 4 / 4.0).max()), table

    coarse, table = error(verify=1)
    assert error(rtol=1e-13, atol=1e-13)[0] == pytest.approx(coarse, rel=1e-6)
    assert error(dt=0.02)[0] / error(dt=0.01)[0] == pytest.approx(4.0, rel=0.1)
    assert table.attrs["manifest"]["self_check"]["largest"]["level"] > 0.7 * coarse
