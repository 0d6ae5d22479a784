"""An atlas that continues an earlier one: the same result as at once, and nothing is computed twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.analysis.atlas.periodic_orbits import OrbitSearch
from gaitsweep.analysis.continuation.branch_follower import BranchFollower
from gaitsweep.cli.main import main
from gaitsweep.examples.henon import Henon
from gaitsweep.job import JobError

FIELDS: dict[str, Any] = {
    "parameter": "a", "path": (0.2, 1.0), "at": 0.5, "ranges": {"x_0": (-2.0, 2.0), "y_0": (-1.0, 1.0)},
    "second": {"b": (0.2, 0.4)}, "periods": 2, "batch": 16, "verify": 0, "most": 30,
}  # fmt: skip
EARLIER: dict[str, Any] = {"budget": 32, "patience": 9, "branches": 100, "depth": 0}
WHOLE: dict[str, Any] = {"budget": 64, "patience": 18, "branches": 200, "depth": 1}


class Counts:
    """Starts of searches and of branches."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.starts, self.branches = 0, 0
        add, follow = OrbitSearch.add, BranchFollower.follow

        def counted_add(search: OrbitSearch, starts: Any, rows: Any, **drawn: bool) -> set[int]:
            self.starts += len(rows)
            return add(search, starts, rows, **drawn)

        def counted_follow(follower: BranchFollower) -> None:
            self.branches += len(follower.numbers)
            follow(follower)

        monkeypatch.setattr(OrbitSearch, "add", counted_add)
        monkeypatch.setattr(BranchFollower, "follow", counted_follow)

    def taken(self) -> tuple[int, int]:
        """The counts so far, which begin anew."""
        counts = self.starts, self.branches
        self.starts, self.branches = 0, 0
        return counts


@pytest.mark.slow
def test_a_continued_atlas_is_that_of_one_run_and_computes_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the gaits at a = 0.5 that of period 2 doubles, at a flip that the earlier run has located."""
    counts = Counts(monkeypatch)
    earlier = gs.atlas(Henon(), **FIELDS, **EARLIER)
    # starts that settled and those that were drawn; both halves of the branches of three gaits
    assert counts.taken() == (16 + 32, 6)
    in_memory = earlier.more()
    # the next drawn starts, and the branch of the doubled gait
    assert counts.taken() == (32, 1)
    gs.atlas(Henon(), out=tmp_path / "henon", **FIELDS, **EARLIER)
    counts.taken()
    assert main(["atlas", str(tmp_path / "henon"), "--more"]) == 0
    assert counts.taken() == (32, 1)
    assert "flip at" in capsys.readouterr().out
    on_disk = gs.Atlas(gs.load(tmp_path / "henon_more"))
    whole = gs.atlas(Henon(), **FIELDS, **WHOLE)
    for continued in (in_memory, on_disk):
        pd.testing.assert_frame_equal(
            continued.table.drop(columns="stored_point"), whole.table.drop(columns="stored_point"), rtol=1e-7,
            atol=1e-9, check_categorical=False,
        )  # fmt: skip
    with pytest.raises(JobError, match=r"run\.after is .*henon, whose run\.seed is 0: give the same"):
        gs.atlas(Henon(), seed=1, after=str(tmp_path / "henon"), **FIELDS, **WHOLE)
    with pytest.raises(JobError, match=r"run\.after: .*nowhere does not exist"):
        gs.atlas(Henon(), after=str(tmp_path / "nowhere"), **FIELDS, **WHOLE)


@pytest.mark.slow
def test_the_four_tables_are_files_that_other_programs_read(tmp_path: Path) -> None:
    henon = gs.atlas(Henon(), out=tmp_path / "henon", **FIELDS, **WHOLE)
    for name in ("gaits", "branches", "points", "curves"):
        table, own = pd.read_parquet(tmp_path / "henon" / f"{name}.parquet"), getattr(henon, name)
        assert len(table) == len(own) > 0
        np.testing.assert_array_equal(table["a"], own["a"])
        assert f"{name}.parquet" in (tmp_path / "henon" / "SHA256SUMS").read_text()
    (tmp_path / "henon" / "gaits.parquet").write_bytes(b"damaged")
    gs.run(tmp_path / "henon" / "job.yaml", tmp_path / "henon")
    assert len(pd.read_parquet(tmp_path / "henon" / "gaits.parquet")) == len(henon.gaits)
