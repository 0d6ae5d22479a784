"""A continuation as a job: its rows, its table, its refusals."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.job import Job, JobError
from gaitsweep.kinds.continuation import branch_ends
from gaitsweep.table import ResultDirectory

RUN = {"kind": "continuation", "parameter": "restitution", "path": [0.2, 0.8], "settle": 5}


def job(**changes) -> Job:
    fields = {
        "name": "hops",
        "model": "toy_model:Toy",
        "vary": {"stiffness": [4.0, 9.0]},
        "run": RUN,
        "numerics": {"method": "rk4", "dt": 1e-2},
        "figures": [{"kind": "continuation", "y": "launch_1", "hue": "stiffness"}],
    }
    return Job(**{**fields, **changes})


@pytest.mark.slow
def test_table_of_branches(tmp_path: Path) -> None:
    """The toy's launch speed u* = kick/(1 - r), kick = w/4 of the stiffness w^2, with multiplier r."""
    reports: list[tuple[float, str]] = []
    gs.run(job(), out=tmp_path, on_progress=lambda *now: reports.append((now[3], now[4])))
    table = gs.load(tmp_path)
    assert set(table["row"]) == {0, 1}
    for row, stiffness in ((0, 4.0), (1, 9.0)):
        branch = table[table["row"] == row]
        assert np.all(branch["stiffness"] == stiffness)
        r = np.asarray(branch["restitution"])
        assert r[0] == 0.2
        assert r[-1] == 0.8
        np.testing.assert_allclose(branch["launch_1_n"], 0.25 * np.sqrt(stiffness) / (1.0 - r), rtol=1e-8)
        np.testing.assert_allclose(branch["multiplier_re"], r, atol=1e-8)
        assert branch["end"].tolist()[-1] == "range"
        assert set(branch["status"]) == {"complete"}
    assert table["gait"].dtype == "category"
    assert (tmp_path / "figures" / "continuation.png").exists()
    assert [note for _, note in reports[:2]] == ["compiling", "compiling, settling for 5 cycles"]
    under_way = [(share, note) for share, note in reports if 0.0 < share < 1.0]
    assert [share for share, _ in under_way] == sorted(share for share, _ in under_way)  # it has no fold
    assert under_way[-1][0] > 0.5
    assert re.match(r"\d+ points of 2 branches, [12] not at their ends", under_way[-1][1])


@pytest.mark.slow
def test_where_branches_begin_is_compared_with_the_stored_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = gs.run(job(figures=[]), out=tmp_path / "same").manifest["self_check"]
    assert (result["rows"], result["stored_differs"], result["verdict"]) == (2, 0, "passed")
    assert result["finer"].startswith("0.38 of")

    def altered(directory: ResultDirectory, rows: Any = None) -> pd.DataFrame:
        table = gs.load(directory.path, rows=rows)
        return table.assign(launch_1_n=table["launch_1_n"] + np.where(table["row"] == 1, 1e-4, 0.0))

    monkeypatch.setattr(ResultDirectory, "load", altered)
    with pytest.warns(UserWarning, match="did not reproduce its stored records"):
        result = gs.run(job(figures=[]), out=tmp_path / "other").manifest["self_check"]
    assert (result["stored_differs"], result["status_differs"], result["verdict"]) == (1, 0, "warned")


@pytest.mark.slow
def test_branch_followed_again_with_half_the_step_is_compared_with_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A branch that is lost begins at the fixed point of half the step, and at that of no other step."""
    differ = {}
    for dt in (0.1, 0.05, 0.07):
        steps, out = {"method": "rk4", "dt": dt}, tmp_path / f"{dt}"
        gs.run(job(figures=[], vary={"stiffness": [9.0]}, numerics=steps, verify=0), out=out)
        monkeypatch.setattr(ResultDirectory, "load", lambda _, rows=None, out=out: gs.load(out, rows=rows))
        checked = job(figures=[], vary={"stiffness": [9.0]}, numerics={"method": "rk4", "dt": 0.1})
        differ[dt] = gs.run(checked, out=tmp_path / f"{dt} checked").manifest["self_check"]["stored_differs"]
    assert differ == {0.1: 0, 0.05: 0, 0.07: 1}


@pytest.mark.slow
def test_blocks_without_a_fixed_point() -> None:
    """A block in which no row has one fits to a block whose row does; Newton fails from x = 1e4."""
    run = gs.Continuation(parameter="r", path=[-0.3, -0.2], settle=5, longest=0.5, step=0.5)
    options = {"run": run, "engine": {"block": 1}, "numerics": {"method": "rk4", "dt": 2e-2}, "verify": 0}
    result = gs.sweep("cusp_flow:CuspFlow", a=0.5, x_0=[1e4, 0.5], **options)
    table = result.table
    assert table.loc[table["row"] == 0, "status"].tolist() == ["no_fixed_point"]
    branch = table[table["row"] == 1]
    assert set(branch["status"]) == {"complete"}
    assert branch["stable"].tolist() == [True] * len(branch)
    result.plot.continuation(x="r", y="x")


@pytest.mark.slow
def test_branches_that_cross_a_symmetric_gait() -> None:
    """X' = a x - x^3: x = 0 loses stability at a = 0 to both x^2 = a, whose multipliers are exp(-2 a)."""
    run = gs.Continuation(parameter="a", path=[-0.5, 0.5], settle=2, crossing=True)
    result = gs.sweep(
        "cusp_flow:CuspFlow", r=0.0, x_0=0.2, run=run, numerics={"method": "rk4", "dt": 1e-2}, verify=0
    )
    table = result.table
    found = table[table["special"] != ""]
    assert found["special"].tolist() == ["supercritical_pitchfork"]
    np.testing.assert_allclose(found["a"], 0.0, atol=1e-8)
    own, across = table.loc[table["branch"] == 0], table.loc[table["branch"] > 0]
    np.testing.assert_allclose(own["x_n"], 0.0, atol=1e-8)
    assert not own.loc[own["a"] > 1e-3, "stable"].any()
    assert sorted(across.drop_duplicates(["branch"])["gait"]) == ["left", "right"]
    np.testing.assert_allclose(across["x_n"] ** 2, across["a"], atol=1e-7)
    np.testing.assert_allclose(across["multiplier_re"], np.exp(-2.0 * across["a"]), atol=1e-6)
    result.plot.continuation(y="x")


def test_ends_of_branches_are_told_with_their_reasons() -> None:
    """Leaving the range is no news; other ends have a sentence, with the place and what it means or helps."""
    table = pd.DataFrame(
        {
            "k": [0.0, 1.0, -0.8806, 0.25, 0.5, 0.0],
            "end": pd.Categorical(["", "range", "lost", "most", "most", "left"]),
        }
    )
    lost, most, left = branch_ends(table, "k", most=300)
    assert "The branch ended as lost at k = -0.8806, because" in lost
    assert "2 branches ended as most at k = 0.25, 0.5" in most
    assert "run.most points, 300" in most
    assert "No fixed point for the branch to begin from at k = 0" in left


def test_refusals() -> None:
    for run, words in (
        ({**RUN, "path": [0.2, 0.2]}, "like the start of the branch"),
        ({**RUN, "path": [0.2, 1.5]}, "restitution|must be"),
        ({**RUN, "step": 0.5}, "must lie between run.shortest"),
        ({**RUN, "parameter": "restitutio"}, "did you mean restitution"),
    ):
        with pytest.raises(JobError, match=words):
            job(run=run)
    with pytest.raises(JobError, match="which needs a run of kind continuation"):
        job(run={"kind": "settle"})
    with pytest.raises(JobError, match="fix"):
        job(run={**RUN, "fix": ["E"]})
    with pytest.raises(JobError, match="semi_implicit"):
        job(model="waist_quadruped", vary=None, run={**RUN, "parameter": "f", "path": [2.0, 3.0]},
            numerics={"method": "semi_implicit", "dt": 2e-4},
            figures=[{"kind": "continuation", "y": "delta_13"}])  # fmt: skip
