"""Refined runs as a user makes them: against full grids, stopped, resumed, over devices, refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.job import JobError
from gaitsweep.runs import refinement
from gaitsweep.runs.estimate import estimate
from gaitsweep.table import EncodedPart, ResultDirectory
from gaitsweep.view.report import write_report
from landscape_model import is_near

TURN = 2 * np.pi
REFINED = {"kind": "settle", "max_cycles": 60, "refine": "boundary"}


def job(run: dict | None = None, **changes) -> gs.Job:
    """Two panels of 32 x 25 starts; the middle axis is the panels'."""
    vary = {
        "theta_2": {"linspace": [0, TURN, 32], "at": "centre"},
        "shift": [0.3, 2.0],
        "theta_1": {"linspace": [0, TURN, 25], "at": "centre"},
    }
    fields = {
        "name": "landscape",
        "model": "landscape_model:Landscape",
        "vary": vary,
        "run": REFINED if run is None else run,
        "numerics": {"dt": 0.05},
        "engine": {"block": 200, "lanes": 32},
        "figures": [{"kind": "basin", "x": "theta_1", "y": "theta_2", "panels": "shift"}],
    }
    return gs.Job(**{**fields, **changes})


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    return gs.run(job({"kind": "settle", "max_cycles": 60}), tmp_path_factory.mktemp("full") / "out").table


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return gs.run(job(), tmp_path_factory.mktemp("refined") / "out").path


@pytest.mark.slow
def test_the_picture_is_that_of_the_full_grid(full: pd.DataFrame, whole: Path) -> None:
    """Every label is the full grid's and the closed form's; simulated rows are equal to the last bit."""
    table = gs.load(whole)
    assert list(table.columns) == list(full.columns)
    assert table.dtypes.equals(full.dtypes)
    near = is_near(full["theta_1"].to_numpy(), full["theta_2"].to_numpy(), full["shift"].to_numpy())
    np.testing.assert_array_equal(full["gait"] == "near", near)
    pd.testing.assert_series_equal(table.loc[:, "gait"], full.loc[:, "gait"])
    simulated = (table["status"] == "settled").to_numpy()
    assert 0.1 < simulated.mean() < 0.45
    pd.testing.assert_frame_equal(table.loc[simulated], full.loc[simulated], check_exact=True)
    others = table.loc[~simulated]
    assert set(others["status"]) == {"inferred"}
    assert others[["theta_1_end", "theta_2_end", "t_end", "away"]].isna().all(axis=None)
    assert not others[["cycles", "side"]].any(axis=None)


def test_counts_add_up_and_figures_and_report_are_made(whole: Path) -> None:
    result = gs.Result(whole)
    counts = result.manifest["counts"]
    assert sum(counts.values()) == 1600
    assert set(counts) == {"settled", "inferred"}
    assert result.manifest["refinement"] == {
        "rounds": result.manifest["refinement"]["rounds"],
        "simulated": counts["settled"],
    }
    assert result.manifest["complete"]
    assert [figure.name for figure in result.figures] == ["basin.png"]
    assert "inferred" in write_report(whole).read_text()
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*.parquet")}
    gs.run(job(), whole)
    assert before == {path: path.stat().st_mtime_ns for path in whole.rglob("*.parquet")}


@pytest.mark.slow
def test_a_run_stopped_after_any_part_gives_the_same_table(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is stopped at the first part, the second and so on; no finished row is run again."""
    write = ResultDirectory.write_encoded
    written: list[Path] = []

    def stop(self: ResultDirectory, number: int, part: EncodedPart) -> None:
        write(self, number, part)
        written.append(self.path)
        raise KeyboardInterrupt

    out = tmp_path / "stopped"
    monkeypatch.setattr(ResultDirectory, "write_encoded", stop)
    while True:
        try:
            gs.run(job(), out)
            break
        except KeyboardInterrupt:
            assert len(written) < 100
    monkeypatch.undo()
    rounds = list((whole / refinement.FOLDER).rglob("*.parquet"))
    parts = list((whole / "table").iterdir())
    assert len(written) == len(rounds) + len(parts)  # each part was written once
    pd.testing.assert_frame_equal(gs.load(out), gs.load(whole), check_exact=True)
    assert gs.Result(out).manifest["counts"] == gs.Result(whole).manifest["counts"]


def test_parts_that_are_lost_or_damaged_are_made_again(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "damaged"
    shutil.copytree(whole, out)
    expected = gs.load(whole)
    (out / "table" / "part-00001.parquet").write_bytes(b"nothing")
    (out / refinement.FOLDER / "round-01" / "table" / "part-00000.parquet").unlink()
    with pytest.warns(UserWarning, match="damaged"):
        gs.run(job(), out)
    pd.testing.assert_frame_equal(gs.load(out), expected, check_exact=True)
    shutil.rmtree(out / refinement.FOLDER)
    (out / "table" / "part-00005.parquet").unlink()
    gs.run(job(), out)
    pd.testing.assert_frame_equal(gs.load(out), expected, check_exact=True)


@pytest.mark.slow("engine1")
@pytest.mark.parametrize("engine", [{"devices": 1}, {"block": 70}])
def test_neither_devices_nor_blocks_count(whole: Path, tmp_path: Path, engine: dict) -> None:
    other = job(engine={**job().engine.model_dump(), **engine})
    _same(gs.run(other, tmp_path / "out").table, gs.load(whole))


@pytest.mark.slow
def test_devices_of_xla_do_not_count(tmp_path: Path) -> None:
    xla = {**job().engine.model_dump(), "name": "xla"}
    _same(*(gs.run(job(engine={**xla, "devices": n}), tmp_path / str(n)).table for n in (1, 2)))


def _same(table: pd.DataFrame, other: pd.DataFrame) -> None:
    columns = [name for name in table if name != "away"]  # labels are read in blocks, to their last bits
    pd.testing.assert_frame_equal(table.loc[:, columns], other.loc[:, columns], check_exact=True)
    np.testing.assert_allclose(table["away"], other["away"], atol=1e-12)


@pytest.mark.slow
def test_labels_are_not_inferred_from_falls(tmp_path: Path) -> None:
    """All rows that fall, and the edge of their region, are simulated."""
    fallen = job(params={"cliff": 0.5}, vary={**job().vary, "shift": [0.3]})
    table = gs.run(fallen, tmp_path / "out").table
    falls = np.cos(table["theta_2"]) > 0.5
    np.testing.assert_array_equal(table["status"] == "fell", falls)
    assert np.mean(table["status"] == "inferred") > 0.2
    near = is_near(table["theta_1"].to_numpy(), table["theta_2"].to_numpy(), 0.3)
    np.testing.assert_array_equal((table["gait"] == "near")[~falls], near[~falls])


def test_refinement_over_a_parameter(tmp_path: Path) -> None:
    """`over` names the axes: a parameter's is refined, and the starts' are panels."""
    vary = {"bend": {"linspace": [0.0, 2.0, 30]}, "theta_1": [0.5, 1.0], "theta_2": {"linspace": [1, 2, 2]}}
    table = gs.run(
        job({**REFINED, "over": ["bend"], "coarse": 4}, vary=vary, figures=[]), tmp_path / "o"
    ).table
    near = is_near(table["theta_1"].to_numpy(), table["theta_2"].to_numpy(), 0.0, table["bend"].to_numpy())
    np.testing.assert_array_equal(table["gait"] == "near", near)
    assert np.sum(table["status"] == "inferred") > 30


def test_the_estimate_counts_a_share_of_the_rows() -> None:
    needs = estimate(job())
    everything = estimate(job({"kind": "settle", "max_cycles": 60}))
    assert needs.rows == everything.rows == 1600
    assert 0.1 < needs.simulated / needs.rows < 0.4
    assert everything.simulated == 1600
    assert needs.seconds_most > 2 * needs.seconds


def test_progress_rises_to_the_end(tmp_path: Path) -> None:
    reports: list[tuple[int, float]] = []

    def on_progress(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        assert total == 1600
        assert 0 <= done <= total
        reports.append((done, fraction))
        assert (fraction < 1.0) == note.startswith(("compiling", "round ")), note
        if note.startswith("round "):
            assert done < total / 2  # rows that were simulated; the others are inferred
            assert ("of a coarse grid" in note) == note.startswith("round 1 ")

    gs.run(job(figures=[]), tmp_path / "out", on_progress=on_progress)
    shares = [fraction for _, fraction in reports]
    assert shares == sorted(shares)
    assert shares[-1] > 0.9


@pytest.mark.slow
def test_stalled_rows_keep_the_names_of_their_events(tmp_path: Path) -> None:
    """Blocks of inferred rows alone, and blocks with stalled rows, have columns of the same types."""
    cells = {"linspace": [0, TURN, 32], "at": "centre"}
    fields = {"params": {"cliff": 0.9}, "vary": {"theta_2": cells, "theta_1": cells}, "figures": []}
    stuck = job(model="landscape_model:StuckLandscape", engine={"block": 4, "lanes": 32}, verify=0, **fields)
    table = gs.run(stuck, tmp_path / "out").table
    is_inferred = (table["status"] == "inferred").to_numpy(bool).reshape(-1, 4)
    assert np.all(is_inferred, axis=1).any()
    stalled = (table["status"] == "event_stall").to_numpy(bool)
    assert stalled.any()
    assert set(table.loc[stalled, "stalled_by"]) == {"a second ends"}
    assert np.all(table.loc[~stalled, "stalled_by"].isna())
    assert table["stalled_by"].cat.categories.tolist() == ["a second ends"]


@pytest.mark.parametrize(
    ("run", "vary", "said"),
    [
        ({"refine": "edges"}, None, "boundary"),
        ({"refine": "boundary", "coarse": 12}, None, "did you mean 8 or 16"),
        ({"refine": "boundary", "coarse": 1}, None, "from 2 to 1024"),
        ({"over": ["theta_1"]}, None, "run.over has no effect without run.refine"),
        ({"coarse": 4}, None, "run.coarse has no effect without run.refine"),
        ({"refine": "boundary", "over": ["theta_3"]}, None, "did you mean theta_1|did you mean theta_2"),
        ({"refine": "boundary", "over": ["shift"]}, None, "do not form a grid"),
        ({"refine": "boundary", "over": ["theta_1", "theta_1"]}, None, "twice"),
        ({"refine": "boundary"}, {"theta_1": [0, 1, 2], "theta_2": {"random": [0, 1, 9]}}, "needs a grid"),
        (
            {"refine": "boundary"},
            {"sample": {"n": 9, "of": {"theta_1": [0, 1], "theta_2": [0, 1]}}},
            "a grid",
        ),
    ],
)
def test_runs_that_cannot_be_refined_are_refused(run: dict, vary: dict | None, said: str) -> None:
    with pytest.raises(JobError, match=said):
        job({"kind": "settle", **run}, vary=job().vary if vary is None else vary, figures=[])


def test_jobs_that_do_not_refine_keep_their_hash() -> None:
    """The fields of a refinement do not count where there is none, so that older directories go on."""
    plain = {"kind": "settle", "max_cycles": 60}
    hashes = {job({**REFINED, "coarse": coarse}).hash() for coarse in (4, 8)} | {job(plain).hash()}
    assert len(hashes) == 3
    again = gs.Job(**json.loads(json.dumps(job().resolved())))
    assert again.hash() == job().hash()
    grid = job().run.refined(job().design)
    assert grid is not None
    assert grid.wraps == {0: True, 2: True}
