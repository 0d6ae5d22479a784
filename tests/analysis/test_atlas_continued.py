"""A wider atlas, and the files of an atlas."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.examples.henon import Henon
from gaitsweep.job.load import wider_job

FIELDS: dict[str, Any] = {
    "parameter": "a", "path": (0.2, 1.0), "at": 0.5, "ranges": {"x_0": (-2.0, 2.0), "y_0": (-1.0, 1.0)},
    "second": {"b": (0.2, 0.4)}, "periods": 2, "batch": 16, "most": 30,
}  # fmt: skip
JOB: dict[str, Any] = {"name": "henon", "model": "gaitsweep.examples.henon:Henon", "verify": 0}
EARLIER: dict[str, Any] = {"budget": 32, "patience": 9, "branches": 100, "depth": 0}
WHOLE: dict[str, Any] = {"budget": 64, "patience": 18, "branches": 200, "depth": 1}


def test_more_is_the_job_with_twice_the_starts_and_one_bifurcation_more() -> None:
    earlier, whole = (gs.Job(**JOB, run={"kind": "atlas", **FIELDS, **extent}) for extent in (EARLIER, WHOLE))
    assert wider_job({"job": earlier.resolved()}).resolved() == whole.resolved()


def test_the_largest_cost_is_no_smaller_than_the_likely_one() -> None:
    """Nor is more than `branches` of `most` points expected."""
    few = {"branches": 3, "batch": 1, "budget": 1}
    for extent in (EARLIER, WHOLE, few, {**few, "most": 4}):
        job = gs.Job(**JOB, run={"kind": "atlas", **FIELDS, **extent})
        cost = job.run.cost(job.design, 1.0, 1.0)
        assert cost.likely <= cost.most
        assert cost.records <= job.run.branches * job.run.most  # type: ignore[union-attr]


@pytest.mark.slow
def test_the_four_tables_are_files_that_other_programs_read(tmp_path: Path) -> None:
    henon = gs.atlas(Henon(), out=tmp_path / "henon", verify=0, **FIELDS, **WHOLE)
    for name in ("gaits", "branches", "points", "curves"):
        table, own = pd.read_parquet(tmp_path / "henon" / f"{name}.parquet"), getattr(henon, name)
        assert len(table) == len(own) > 0
        np.testing.assert_array_equal(table["a"], own["a"])
        assert f"{name}.parquet" in (tmp_path / "henon" / "SHA256SUMS").read_text()
    (tmp_path / "henon" / "gaits.parquet").write_bytes(b"damaged")
    gs.run(tmp_path / "henon" / "job.yaml", tmp_path / "henon")
    assert len(pd.read_parquet(tmp_path / "henon" / "gaits.parquet")) == len(henon.gaits)
