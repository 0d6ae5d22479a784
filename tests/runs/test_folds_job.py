"""Curves of folds as a job: rows, table, figure, refusals, and continuation of a killed run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pandas.testing import assert_frame_equal

import gaitsweep as gs
from gaitsweep.job import Job, JobError
from gaitsweep.runs.estimate import estimate

RUN: dict[str, Any] = {
    "kind": "folds",
    "parameters": ["r", "a"],
    "within": {"r": [-1.0, 1.0], "a": [-0.5, 1.5]},
    "settle": 20,
}


def job(**changes: Any) -> Job:
    fields: dict[str, Any] = {
        "name": "cusp",
        "model": "cusp_flow:CuspFlow",
        "vary": {"x_0": [1.0, -1.0]},
        "run": RUN,
        "numerics": {"method": "rk4", "dt": 2e-2},
        "engine": {"block": 1},
        "figures": [{"kind": "folds"}],
    }
    return Job(**{**fields, **changes})


@pytest.mark.slow
def test_both_folds_and_their_cusp(tmp_path: Path) -> None:
    """27 r^2 = 4 a^3, x^2 = a/3, and a cusp at 0; to what Newton leaves, as the equilibria are exact."""
    asked = job()
    path = gs.run(asked, out=tmp_path).path
    table = gs.load(path)
    assert set(table["row"]) == {0, 1}
    for _, curve in table.groupby("row"):
        r, a, x = (curve[name].to_numpy(float) for name in ("r_fold", "a_fold", "x_n"))
        np.testing.assert_allclose(27.0 * r**2, 4.0 * a**3, atol=1e-6)
        np.testing.assert_allclose(3.0 * x**2, a, atol=1e-5)
        np.testing.assert_allclose(curve["multiplier"], 1.0, atol=1e-6)
        assert set(curve["unstable"]) == {0}
        assert np.all(np.diff(curve["point"]) == 1)
        assert (curve["end"].iloc[0], curve["end"].iloc[-1]) == ("range", "range")
        tip = curve.loc[curve["special"] == "cusp"]
        np.testing.assert_allclose(tip[["r_fold", "a_fold"]].to_numpy(float), [[0.0, 0.0]], atol=1e-6)
        away = curve[curve["special"] != "cusp"]
        # where r is below 0 the right equilibrium meets the middle one, and both lie above the curve
        np.testing.assert_array_equal(away["side"], -np.sign(away["r_fold"]))
        np.testing.assert_array_equal(away["gait"] == "right", away["r_fold"] < 0.0)
    assert 1 / 3 < estimate(asked).records / len(table) < 3
    assert (tmp_path / "figures" / "folds.png").exists()
    for part in (tmp_path / "table").glob("part-00001*"):  # as if it was killed in its second row
        part.unlink()
    assert_frame_equal(gs.load(gs.run(job(), out=tmp_path).path), table, check_exact=True)


@pytest.mark.slow
def test_no_fold_and_no_fixed_point(tmp_path: Path) -> None:
    table = gs.run(job(vary={"a": [-0.2], "x_0": [0.5, 1e4]}), out=tmp_path).table
    assert table["status"].tolist() == ["complete", "no_fixed_point"]
    assert table["end"].iloc[0] == "no_fold"
    assert table["r_fold"].notna().tolist() == [False, False]
    assert (tmp_path / "figures" / "folds.png").exists()


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (
            {"parameters": ["r", "aa"], "within": {"r": [-1, 1], "aa": [0, 1]}},
            r"parameters\[1\] is aa, which",
        ),
        ({"parameters": ["r", "r"]}, r"parameters\[1\] is r, like the first"),
        ({"within": {"r": [-1, 1]}}, "within has no range for a"),
        ({"within": {"r": [-1, 1], "a": [0, 2], "b": [0, 1]}}, "b is not one of run.parameters"),
        ({"within": {"r": [1, -1], "a": [0, 2]}}, "must be lower"),
        ({"within": {"r": [-1, 1], "a": [0, 20]}}, r"a\[1\] is 20, but must be from -10 to 10"),
        ({"within": {"r": [-1, 1], "a": [0, 0.5]}}, "a begins at 1 in row 0"),
        ({"step": 0.5}, "must lie between run.shortest"),
    ],
)
def test_refusals(run: dict[str, Any], words: str) -> None:
    with pytest.raises(JobError, match=words):
        job(run={**RUN, **run})


def test_figures_need_their_run() -> None:
    with pytest.raises(JobError, match="which needs a run of kind folds, not settle"):
        job(run={"kind": "settle"})
