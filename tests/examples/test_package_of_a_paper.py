"""The package of a fourth paper, docs/papers/goswami1998, as installed by a user."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from tests.support import unoptimised_flags
from tests.support.installed_packages import ROOT, install, run_module


@pytest.mark.slow
def test_the_compass_gait_is_a_package_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Installed by pip, it has models, claims with verdicts, an analysis and tests of its own."""
    monkeypatch.setenv("XLA_FLAGS", unoptimised_flags())
    package = str(ROOT / "docs/papers/goswami1998")
    site = install(tmp_path, package)
    described = run_module(tmp_path, "gaitsweep", "models", "goswami1998", site=site)
    assert described.startswith("goswami1998: ")
    printed = run_module(tmp_path, "gaitsweep", "reproduce", "goswami1998", "--quick", site=site)
    assert (
        "14 of 21 claims reproduced, 1 not reproduced, 3 true by definition, 1 answered, 2 not run" in printed
    )
    results = tmp_path / "results/reproduce_goswami1998"
    claims = pd.read_parquet(results / "claims.parquet").set_index("id")
    # Goswami, Thuilot and Espiau 1998, as quoted: 4.37 to 4.39 degrees
    assert claims.loc["first_doubling", "value"] == pytest.approx(4.39, abs=0.02)
    assert claims.loc["steps_differ", "value"] == pytest.approx(4.39, abs=0.02)
    drawn = {each.stem for each in (results / "quick/crossings/figures").glob("*.png")}
    assert drawn == {"goswami1998_bifurcations", "bifurcations_alpha"}
    steps = run_module(
        tmp_path, "gaitsweep", "analyse", "goswami1998-steps", str(results / "quick/cascade"), site=site
    )
    assert [line.split()[0] for line in steps.splitlines() if "settled" in line][:4] == ["1", "2", "4", "8"]
    tests = run_module(tmp_path, "pytest", "-q", "-p", "no:cacheprovider", "-c", f"{package}/pyproject.toml",
               f"{package}/tests", site=site)  # fmt: skip
    assert "8 passed" in tests
