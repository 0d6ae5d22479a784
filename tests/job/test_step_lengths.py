"""Step lengths of a job's rows: the longest accurate one, and explicit ones that are too long."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.job import Job, JobError
from gaitsweep.job.step_lengths import _rounded_down, row_steps
from gaitsweep.runs.prepare import row_values


def test_each_row_has_its_own_longest_step() -> None:
    job = Job(
        name="masses", model="multilegged", vary={"m_B": [0.6, 0.9], "psi_1": [1, 2, 3]},
        start={"psi_2": 2, "psi_3": 3}, run={"kind": "settle"},
    )  # fmt: skip
    steps = row_steps(job.design, job.run, job.integration)
    assert steps.dt.size == 2, "two sets of parameters, whatever the starts"
    assert steps.rows_per_set == 3
    assert steps.dt[0] < 0.7 * steps.dt[1]
    resolved = job.resolved()["numerics"]
    assert (resolved["method"], resolved["dt"]) == ("propagator6", "auto")
    assert "rtol" not in resolved


def test_a_ramp_has_the_step_of_its_whole_path() -> None:
    run = {"kind": "ramp", "parameter": "m_B", "path": [0.9, 0.5, 0.9], "rate": 0.01}
    start = {"psi_1": 1, "psi_2": 2, "psi_3": 3}
    moving = Job(name="ramp", model="multilegged", start=start, run=run)
    still = Job(name="still", model="multilegged", start=start, params={"m_B": 0.5}, run={"kind": "settle"})
    (ramp,), (least,) = (row_steps(job.design, job.run, job.integration).dt for job in (moving, still))
    assert ramp == pytest.approx(least)


@pytest.mark.slow("numerics0-sentences0")
@pytest.mark.parametrize(
    ("numerics", "sentences"),
    [
        ({"method": "propagator6", "dt": 32e-3}, ["too long for 36 of 72 rows", "0.02576 s (at m_B = 0.7)"]),
        ({"method": "rk4", "dt": 4.5e-3}, ["too long for 36 of 72 rows", "longest accurate step of rk4"]),
        ({"dt": 32}, ["numerics.dt is 32 s, too long for 72 of 72 rows"]),
        ({"method": "rk4", "dt": 1e-300}, ["numerics.dt is 1e-300 s, below the rounding of the time"]),
        ({"method": "tsit5", "dt": 1e-18}, ["numerics.dt is 1e-18 s, below the rounding of the time"]),
    ],
)
def test_an_explicit_step_is_neither_too_long_nor_too_short(numerics: dict, sentences: list[str]) -> None:
    """The readme's own example: at 0.7 kg steps of 32 ms lost 31 of 36 rows without a message."""
    phases = {"linspace": [0, "2*pi", 6], "at": "centre"}
    fields: dict[str, Any] = {
        "name": "end_mass", "model": "multilegged", "start": {"psi_3": "pi"}, "run": {"kind": "settle"},
        "vary": {"m_B": [0.7, 0.9], "psi_1": phases, "psi_2": phases},
    }  # fmt: skip
    with pytest.raises(JobError) as refused:
        Job(**fields, numerics=numerics)
    for sentence in sentences:
        assert sentence in str(refused.value)
    Job(**fields, numerics={"method": "propagator6", "dt": 25e-3})


def test_a_row_with_almost_no_rate_does_not_refuse_a_step() -> None:
    """Its period is 1e18 times as long as that of the other row."""
    run = {"kind": "settle"}
    fields: dict[str, Any] = {"name": "weak", "model": "toy_model:Toy", "vary": {"stiffness": [4, 4e-36]}}
    Job(**fields, run=run, numerics={"dt": 1e-2})
    with pytest.raises(JobError, match="below the rounding of the time"):
        Job(**fields, run=run, numerics={"dt": 1e-18})


@pytest.mark.parametrize("path", [[3.0, 300.0], [300.0, 3.0]])
def test_the_limit_from_a_period_covers_the_whole_path(path: list[float]) -> None:
    """Also of a model that tells no fast modes; the direction of the path makes no difference."""
    run = {"kind": "ramp", "parameter": "rate", "path": path, "rate": 10}
    fields: dict[str, Any] = {"name": "fast", "start": {"theta_1": 1, "theta_2": 2}, "run": run}
    with pytest.raises(JobError, match=r"longest accurate step of rk4 for all of them is 0\.00125 s"):
        Job(model="landscape_model:FasterLandscape", **fields, numerics={"method": "rk4", "dt": 0.02})
    Job(model="landscape_model:FasterLandscape", **fields, numerics={"method": "rk4", "dt": 1.2e-3})


class Spring(gs.DeclaredModel):
    """An oscillator that tells its fast mode only where it has one."""

    k = gs.parameter("1/s2", "stiffness", 1.0)
    x = gs.variable("m", "position", 1.0)
    v = gs.variable("m/s", "speed", 0.0)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": s.v, "v": -p.k * s.x}

    def period(self, p: Any) -> Any:
        return 6.0 + 0.0 * p.k

    def fast_modes(self, p: Any) -> Any:
        return jnp.sqrt(p.k)[None], jnp.zeros(1)


def test_a_row_without_a_known_limit_leaves_the_others_theirs() -> None:
    numerics = {"method": "rk4", "dt": 0.5}
    with pytest.raises(JobError, match=r"too long for . of 3 rows.*0\.0[0-9]* s \(at k = 10000\)"):
        gs.sweep(Spring(), k=[-1.0, 1.0, 1e4], run=gs.FixedTime(duration=1.0), numerics=numerics)
    # without a step it cannot run, wherever it stands
    result = gs.sweep(
        Spring(), k=[-1.0, 1.0], run=gs.FixedTime(duration=1.0), numerics={"method": "rk4"}, verify=0
    )
    assert result.table["status"].tolist() == ["not_a_number", "complete"]


def test_steps_of_unexamined_rows_are_checked_when_they_begin() -> None:
    """Also where some rows of the job are simulated, as in a round of a refined run."""
    start = {"psi_1": 1, "psi_2": 2, "psi_3": 3}
    job = Job(
        name="some", model="multilegged", start=start, run={"kind": "settle"}, vary={"m_B": [0.9, 0.9, 0.7]}
    )
    steps = dataclasses.replace(row_steps(job.design, job.run, job.integration), sampled=True)
    numerics = dataclasses.replace(job.integration, dt=27e-3)

    def values(*rows: int) -> np.ndarray:
        given = row_values(job.design, job.run, numerics, steps, lambda a, b: np.array(rows)[a:b])
        return given(0, len(rows))[0]["m_B"]

    assert values(1, 0).tolist() == [0.9, 0.9]
    with pytest.raises(JobError, match=r"too long for row 2: use at most 0\.02"):
        values(0, 2)


@pytest.mark.parametrize(("limit", "rounded"), [(0.0123456, 0.01234), (0.0, 0.0), (-1.0, -1.0)])
def test_the_limit_in_a_message_is_rounded_down(limit: float, rounded: float) -> None:
    """A model may be wrong and give no positive step: that is a message too, not a bare error."""
    assert _rounded_down(limit) == pytest.approx(rounded, rel=1e-12)
