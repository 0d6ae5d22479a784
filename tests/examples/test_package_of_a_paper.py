"""The package of a fourth paper, docs/papers/goswami1998, as those get it who install it."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from tests.support.installed_packages import ROOT, at, install


@pytest.mark.slow
def test_the_compass_gait_is_a_package_of_its_own(tmp_path: Path) -> None:
    """Installed by pip it is found, its claims are judged, and the gait doubles at 4.39 degrees."""
    package = str(ROOT / "docs/papers/goswami1998")
    site = install(tmp_path, package)
    assert at(tmp_path, "gaitsweep", "models", "goswami1998", also=site).startswith("goswami1998: ")
    told = at(tmp_path, "gaitsweep", "reproduce", "goswami1998", "--quick", also=site)
    assert "14 of 21 claims reproduced, 1 not reproduced, 3 true by definition, 1 answered, 2 not run" in told
    results = tmp_path / "results/reproduce_goswami1998"
    claims = pd.read_parquet(results / "claims.parquet").set_index("id")
    # Goswami, Thuilot and Espiau 1998, as quoted: 4.37 to 4.39 degrees
    assert claims.loc["first_doubling", "value"] == pytest.approx(4.39, abs=0.02)
    assert claims.loc["steps_differ", "value"] == pytest.approx(4.39, abs=0.02)
    drawn = {each.stem for each in (results / "quick/crossings/figures").glob("*.png")}
    assert drawn == {"goswami1998_bifurcations", "bifurcations_alpha"}
    steps = at(
        tmp_path, "gaitsweep", "analyse", "goswami1998-steps", str(results / "quick/cascade"), also=site
    )
    assert [line.split()[0] for line in steps.splitlines() if "settled" in line][:4] == ["1", "2", "4", "8"]
    tests = at(tmp_path, "pytest", "-q", "-p", "no:cacheprovider", "-c", f"{package}/pyproject.toml",
               f"{package}/tests", also=site)  # fmt: skip
    assert "8 passed" in tests
