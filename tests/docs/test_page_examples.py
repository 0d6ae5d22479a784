"""Files and axes that the pages show are those of a job that runs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

import gaitsweep as gs
from gaitsweep.design.axes import AXIS_KINDS
from tests.support import ROOT

FENCE = re.compile(r"^```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_the_job_reference_shows_each_axis() -> None:
    page = re.sub(r"<!-- described: (\w+) -->.*?<!-- end: \1 -->", "",
                  (ROOT / "docs" / "job_reference.md").read_text(), flags=re.DOTALL)  # fmt: skip
    text = FENCE.sub("", page)
    assert [kind for kind in AXIS_KINDS if kind != "values" and f"{{{kind}: [" not in text] == []
    starts = dict.fromkeys(("psi_1", "psi_2", "psi_3"), 1.0)
    kappa = np.zeros(0)
    for block in FENCE.findall(page):
        vary = yaml.safe_load(block)["vary"]
        fixed = {name: value for name, value in starts.items() if name not in {**vary, **vary.get("zip", {})}}
        job = gs.Job(name="x", model="multilegged", vary=vary, start=fixed, run=gs.Settle())
        kappa = job.design.values(0, job.design.n_rows)[0]["kappa"]
    np.testing.assert_allclose(np.unique(kappa), 10.0 ** np.array([1.0, 1.5, 2.0, 2.5, 3.0]))


@pytest.mark.slow
def test_references_in_pages_are_the_packages() -> None:
    pytest.importorskip("sphinx")
    # a process of its own: kinds are listed in the order of imports, and other tests register theirs
    command = [sys.executable, "docs/extensions/described_package.py", "--check"]
    checked = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True
    )
    assert checked.returncode == 0, (
        f"{checked.stderr.decode()}: run python docs/extensions/described_package.py"
    )


@pytest.mark.slow
def test_observables_of_own_classes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The classes of docs/own_model.md, in files with the names in their first lines."""
    for block in FENCE.findall((ROOT / "docs" / "own_model.md").read_text()):
        if name := re.match(r"# (counted\.py|ordered\.py)\n", block):
            (tmp_path / name[1]).write_text(block)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    start = {"launch_0": 5.1, "phase_0": 1.5}
    job = gs.Job(name="x", model="counted:Counted", start=start, run=gs.Settle(max_cycles=200), verify=0)
    np.testing.assert_allclose(gs.run(job, "counted").table["turns_end"], 2.0, atol=1e-3)
    at_zero = {f"psi_{i}": 0.0 for i in (1, 2, 3)}
    job = gs.Job(name="x", model="ordered:Ordered", start=at_zero, run=gs.FixedTime(duration=1e-3), verify=0)
    ordered = gs.run(job, "ordered")
    assert "order_end" in ordered.table.columns


def test_the_page_on_rows_in_pandas_runs_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts, open rows, joined results and figures, of the gallery's table of the same job."""
    page = (ROOT / "docs/start.md").read_text().partition("### Count, select")[2]
    stored = pd.read_parquet(ROOT / "docs/gallery/basin.parquet")  # the columns that its picture needs
    rows = {"row": range(len(stored)), **{name: stored[name] for name in ("psi_3", "psi_2", "psi_1")}}
    table = pd.DataFrame({**rows, "status": "settled", "cycles": 50, "gait": stored["gait"]})
    table["outcome"], table.attrs = stored["gait"], stored.attrs
    light = table.assign(gait="retrograde", outcome="retrograde")
    light.attrs["job"]["params"] = {**light.attrs["job"]["params"], "m_1": 0.7}
    monkeypatch.setattr(gs, "load", lambda _: light, raising=False)
    names: dict[str, Any] = {"gs": gs, "table": table}
    exec(FENCE.findall(page)[0], names)
    assert names["counts"].to_numpy().sum() == len(table) == names["shares"]["rows"].sum()
    assert len(names["open_rows"]) == len(names["failed"]) == 0
    assert names["heads"].groupby("m_1").sum().to_dict() == {0.7: len(table), 0.9: len(table)}
