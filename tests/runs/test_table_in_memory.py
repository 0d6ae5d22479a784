"""Tables in memory: those of result directories, to the last bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import gaitsweep as gs
from gaitsweep.engine.sweep import engine_choice, lane_scheduler
from gaitsweep.examples.hopper import Hopper
from gaitsweep.table import MemoryTable
from gaitsweep.table.manifest import Layout
from tests.support.toy_directories import block_frame, open_toy

OF_A_DIRECTORY = {"path"}
OF_A_RUN = {"created", "timings", "sha256"}


@pytest.mark.slow("ramp")
@pytest.mark.parametrize(
    "run",
    [
        gs.Settle(max_cycles=60),
        gs.Trace(duration=1.0, every=0.05),
        gs.Ramp(parameter="omega", path=[11.0, 12.0], rate=0.2),
    ],
    ids=["settle", "trace", "ramp"],
)
def test_a_table_in_memory_is_that_of_a_directory(run: Any, tmp_path: Path) -> None:
    keywords: dict[str, Any] = {"launch_0": np.linspace(0.1, 8.0, 5), "run": run}
    memory = gs.sweep(Hopper(), **keywords).table
    stored = gs.sweep(Hopper(), out=tmp_path / "hopper", **keywords).table
    attrs, manifests = [memory.attrs.copy(), stored.attrs.copy()], []
    for each in attrs:
        manifest = each.pop("manifest")
        manifests.append({name: value for name, value in manifest.items() if name not in OF_A_RUN})
    assert attrs[1].keys() - attrs[0].keys() == OF_A_DIRECTORY
    del attrs[1]["path"]
    assert attrs[0] == attrs[1]
    assert manifests[0] == manifests[1]
    memory.attrs.clear()
    stored.attrs.clear()
    pd.testing.assert_frame_equal(memory, stored, check_exact=True)


def test_the_kernel_of_a_short_run_is_compiled_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows are the same to the last bit; a long run has the optimised kernel."""
    quick: list[bool] = []

    def remembering(device: Any, spec: Any) -> Any:
        quick.append(spec.quick)
        return engine_choice.groups_on(device, spec)

    monkeypatch.setattr(lane_scheduler, "groups_on", remembering)
    run = gs.Settle(max_cycles=60)
    launches = np.linspace(0.1, 8.0, 1000)
    short = gs.sweep(Hopper(), launch_0=launches[::200], run=run, verify=0).table
    long = gs.sweep(Hopper(), launch_0=launches, run=run, verify=0).table
    assert list(dict.fromkeys(quick)) == [True, False]
    rows = long.iloc[::200].reset_index(drop=True)
    pd.testing.assert_frame_equal(short.drop(columns="row"), rows.drop(columns="row"), check_exact=True)


def test_a_table_without_a_manifest_is_named() -> None:
    result = gs.Result(table=pd.DataFrame({"row": [0, 1]}))
    assert repr(result) == "Result(records: 2; in memory)"
    for asked in (lambda: result.manifest, result.job):
        with pytest.raises(gs.ArgumentError, match=r"no manifest in its \.attrs.* gs\.concat"):
            asked()


def _none_of(categories: list[str], rows: int) -> pd.Categorical:
    return pd.Categorical([None] * rows, categories)


# A column of the blocks of 4, 4 and 2 rows of a table; a block whose column is None lacks it.
COLUMNS: dict[str, list[Any]] = {
    "whole numbers": [np.arange(4), np.arange(4), np.arange(2)],
    "single precision": [np.arange(n, dtype=np.float32) for n in (4, 4, 2)],
    "flags": [np.arange(n) > 1 for n in (4, 4, 2)],
    "flags in some blocks": [np.arange(4) > 1, None, np.arange(2) > 1],
    "numbers in some blocks": [None, np.array([1.0, np.nan, 2.0, 3.0]), None],
    "whole numbers, then others": [np.arange(4), np.arange(4.0) / 3, np.arange(2)],
    "names of one block": [_none_of([], 4), pd.Categorical(["b", None, "a", "b"]), _none_of([], 2)],
    "names in another order": [pd.Categorical([*"ab"] * 2, [*order]) for order in ("ab", "ba")]
    + [_none_of([*"ba"], 2)],
    "no names": [_none_of([], n) for n in (4, 4, 2)],
    "text": [["x", None, "y", "x"], ["z"] * 4, [None, "x"]],
    "ordered names": [pd.Categorical(["b"] * n, ["b", "a"], ordered=True) for n in (4, 4, 2)],
    "several records of a row": [np.arange(7), np.arange(4), np.arange(2)],
}


@pytest.mark.parametrize("column", COLUMNS.values(), ids=COLUMNS)
def test_blocks_in_memory_give_the_table_of_a_directory(column: list[Any], tmp_path: Path) -> None:
    """The values, types and categories, in whatever order the blocks end."""
    frames = {}
    with open_toy(tmp_path / "toy") as directory:
        for number, values in enumerate(column):
            frame = block_frame(*directory.layout.rows_of(number))
            if values is not None:
                more = np.zeros(len(values) - len(frame), int)
                places = np.sort(np.concatenate([np.arange(len(frame)), more]))
                frame = frame.iloc[places].reset_index(drop=True).assign(column=values)
            directory.write_part(number, frame)
            frames[number] = frame
        memory = MemoryTable(directory.manifest["job"], directory.layout)
        for number in (1, 2, 0):
            memory.write_encoded(number, memory.encoded(number, frames[number].copy()))
        assert memory.tally("gait") == directory.tally("gait")
    stored: Any = gs.load(tmp_path / "toy")
    for table in (memory.load(), memory.load(slice(3, 9)), memory.load(last=True)):
        table.attrs.clear()
        rows = stored[stored["row"].isin(table["row"])].reset_index(drop=True)
        pd.testing.assert_frame_equal(table, rows, check_exact=True)
    (part,) = memory.load_parts(["column", "gait"])
    pd.testing.assert_frame_equal(part, stored[["column", "gait"]], check_exact=True)


def test_records_that_a_table_in_memory_returns_are_the_callers() -> None:
    """Those of `load` may be changed while the run goes on."""
    layout = Layout("abc" * 20, 10, 4)
    memory = MemoryTable({}, layout)
    for number in layout.blocks:
        memory.write_encoded(number, memory.encoded(number, block_frame(*layout.rows_of(number))))
    assert all(part.records is None for part in memory._parts.values())  # which fill the columns
    for rows in (None, slice(0, 10)):
        table = memory.load(rows)
        table.loc[:, "psi_1_end"] = 7.0
        table.loc[:, "gait"] = "source"
    unchanged: Any = memory.load()
    assert not (unchanged["psi_1_end"] == 7.0).any()
    assert unchanged["gait"].isna().any()
