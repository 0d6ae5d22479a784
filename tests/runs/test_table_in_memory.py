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
