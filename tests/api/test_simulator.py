"""Simulators for inference: values in, observables out, and the calibration of a posterior that is known."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import gaitsweep as gs
from tests.support import ROOT

HOPS = {"name": "hops", "model": "gaitsweep.examples.hopper:Hopper", "run": {"kind": "settle"}}
# the step follows `push` by way of another parameter
FOLLOWING = {"params": {"restitution": "push/10"}, "numerics": {"dt": "2e-3*restitution"}}


class Measured(gs.DeclaredModel):
    """A body whose place is measured with an error of its own; it falls where the place is beyond 2.5."""

    place = gs.parameter("m", "place", 0.0, low=-4.0, high=4.0)
    seed = gs.parameter("1", "seed of the error", 0.0, whole=True)
    x = gs.variable("m", "measured place", 0.0)

    def complete(self, p: Any, s: Any) -> Any:
        return s.replace(x=p.place + gs.normal(p.seed, 0))

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": 0.0}

    def failed(self, p: Any, s: Any) -> Any:
        return p.place > 2.5

    def period(self, p: Any) -> Any:
        return 1.0 + 0.0 * p.place


@pytest.mark.slow
def test_a_posterior_by_rejection_is_calibrated() -> None:
    """The rank of the true value among accepted ones is uniform, and failed rows are marked.

    With a flat prior and an error of variance 1, the posterior of the place is normal around the measurement.
    """
    random, n = np.random.default_rng(3), 20_000
    job = {"name": "m", "model": f"{__name__}:Measured", "run": {"kind": "fixed_time", "duration": 0.5}}
    measured = gs.simulator(job, ["place", "seed"], ["x_end"])
    sets = np.stack([random.uniform(-4.0, 4.0, n), np.arange(n)], axis=1)
    observed, status = measured.run(sets)
    fallen = sets[:, 0] > 2.5
    assert np.array_equal(np.isnan(observed[:, 0]), fallen)
    assert set(status[fallen]) == {"fell"}
    place, x = sets[~fallen, 0], observed[~fallen, 0]
    np.testing.assert_allclose(x[:5], place[:5] + gs.normal(sets[~fallen, 1][:5], 0), rtol=1e-12)
    ranks = []
    for true, seen in zip(place[:300], x[:300], strict=True):
        accepted = place[300:][np.abs(x[300:] - seen) < 0.1]
        ranks.append((accepted < true).mean())
    assert stats.kstest(ranks, "uniform").pvalue > 1e-3
    # away from the ends of the prior
    accepted = place[np.abs(x + 0.5) < 0.05]
    assert accepted.mean() == pytest.approx(-0.5, abs=4.0 / np.sqrt(accepted.size))
    assert accepted.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * accepted.size))


def test_one_set_and_tensors_have_their_own_shapes() -> None:
    launched = {**HOPS, "start": {"launch_0": 2.5}}
    hops = gs.simulator(launched, "omega", ["launch_end", "t_end"])

    class Tensor(np.ndarray):
        """A tensor of torch, as far as a simulator sees it."""

        def new_tensor(self, values: Any) -> Tensor:
            return np.asarray(values).view(Tensor)

    one = hops(np.array([12.0]))
    assert one.shape == (2,)
    several = hops(np.array([[12.0], [12.5]]).view(Tensor))
    assert isinstance(several, Tensor)
    np.testing.assert_array_equal(several[0], one)
    assert hops(np.empty((0, 1))).shape == (0, 2)
    # an orbit of one crossing has no second one
    assert np.isnan(gs.simulator(launched, "omega", "launch_end_2")([12.0])).all()
    with pytest.raises(gs.ArgumentError, match=r"\(2, 3\), but 1 parameters"):
        hops(np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("fields", "parameters", "columns", "reason"),
    [
        ({"vary": {"omega": [1.0, 2.0]}}, ["push"], ["launch_end"], "varies omega"),
        ({"run": {"kind": "return_map", "crossings": 3}}, ["omega"], ["launch_n"], "several records"),
        ({}, ["omga"], ["launch_end"], "did you mean omega"),
        ({}, ["omega", "omega"], ["launch_end"], "omega is named twice"),
        ({}, ["omega"], ["launch_nd"], "did you mean launch_end"),
        ({}, ["omega"], ["launch_n_2"], "launch_n_2 is not a column"),
        ({}, ["omega"], ["launch_end", "status"], "status are not numbers"),
        ({}, ["omega"], ["t_end", "launch_end", "t_end"], "t_end is named twice among the columns"),
        ({}, [], ["launch_end"], "no parameter"),
        ({}, ["omega"], [], "no column"),
        # numbers that the job's own values give would stay in all rows
        (
            {"run": {"kind": "settle", "max_time": "9+omega"}},
            ["push", "omega"],
            ["t_end"],
            r"omega .*9\+omega",
        ),
        (FOLLOWING, ["push"], ["t_end"], "restitution"),
    ],
)
def test_a_job_that_is_no_simulator_is_refused(
    fields: Any, parameters: list[str], columns: list[str], reason: str
) -> None:
    with pytest.raises(gs.ArgumentError, match=reason):
        gs.simulator({**HOPS, **fields}, parameters, columns)


def test_files_of_a_job_are_found_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each call reads the job again, with a model beside its file, as a model in YAML is read."""
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "beside_its_job.py").write_text(f"from {__name__} import Measured\n")
    run = {"kind": "fixed_time", "duration": "2*place + 0.1"}
    fields = {"name": "m", "model": "beside_its_job:Measured", "params": {"place": 0.2}, "run": run}
    (tmp_path / "deep" / "job.yaml").write_text(json.dumps(fields))
    monkeypatch.chdir(tmp_path)
    measured = gs.simulator("deep/job.yaml", "seed", ["x_end", "t_end"])
    monkeypatch.delitem(sys.modules, "beside_its_job")
    monkeypatch.chdir(ROOT)
    np.testing.assert_allclose(measured([4.0]), [0.2 + float(gs.normal(4.0, 0)), 0.5], rtol=1e-12)


@pytest.mark.slow
def test_the_posterior_of_unstated_constants_is_calibrated(capsys: pytest.CaptureFixture[str]) -> None:
    """The example of docs/search.md with fewer draws: ranks of true values are uniform (Talts et al. 2018).

    They are not if the errors of reading are taken half as large: then true values lie too often outside.
    """
    page = (ROOT / "docs" / "search.md").read_text()
    example = re.search(r"```python\n(import numpy as np, pandas.*?)```", page, re.DOTALL)
    assert example is not None
    names: dict[str, Any] = {}
    exec(example[1].replace("DRAWS = 512", "DRAWS = 128"), names)
    assert "as good as" in capsys.readouterr().out
    for constant in names["PRIOR"]:
        assert stats.kstest(names["ranks"](constant, experiments=1600), "uniform").pvalue > 1e-3
    overconfident = names["ranks"]("x_c", error=0.5 * names["ERROR"], experiments=1600)
    assert stats.kstest(overconfident, "uniform").pvalue < 1e-6
    # the phases tell x_c, which the walk and the trot of the paper need near 2.7 mm, and hardly K_TL
    values, posterior = names["sets"], names["posterior"]
    means = posterior @ values
    spreads = np.sqrt(posterior @ (values - means) ** 2) / values.std(axis=0)
    assert means[2] == pytest.approx(2.7e-3, abs=0.2e-3)
    assert spreads[2] < 0.4 < 0.6 < spreads[1]


class Follows(gs.DeclaredModel):
    """A place that follows an oscillation, the faster the larger its rate."""

    rate = gs.parameter("1/s", "rate", 1.0, low=0.0)
    x = gs.variable("m", "place", 1.0)
    angle = gs.variable("rad", "angle", 0.0)

    def flow(self, p: Any, s: Any) -> dict[str, Any]:
        return {"x": p.rate * (jnp.cos(s.angle) - s.x), "angle": 1.0}

    def period(self, p: Any) -> Any:
        return 2.0 * jnp.pi + 0.0 * p.rate


def test_the_method_auto_suits_the_sets_of_a_call() -> None:
    """The job's own rate is slow; a stiff set was integrated by the method that suits that one."""
    job = {"name": "f", "model": f"{__name__}:Follows", "run": {"kind": "fixed_time", "duration": 1.0}}
    result = gs.simulator(job, "rate", "x_end").run([[1e7]])
    assert list(result.statuses) == ["complete"]
    np.testing.assert_allclose(result.observed, np.cos(1.0), rtol=1e-5)
