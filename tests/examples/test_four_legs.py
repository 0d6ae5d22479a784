"""The four legs of docs/four_legs.md: the page shows the shipped files; edges of gaits agree with theory."""

from __future__ import annotations

import re

import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.shipped import EXAMPLES, portable_text
from tests.support import ROOT


def test_the_page_shows_the_files_that_are_copied() -> None:
    blocks = re.findall(
        r"^```\w+\n(.*?)^```$", (ROOT / "docs/four_legs.md").read_text(), re.MULTILINE | re.DOTALL
    )
    names = ("four_legs.py", "four_legs.yaml", "four_legs_hysteresis.yaml")
    assert [name for name in names if portable_text(EXAMPLES / name) not in blocks] == []


@pytest.mark.slow
def test_edges_of_trot_and_pace() -> None:
    """Haken, Kelso and Bunz 1985: without load feedback a trot ends at -2 K_two, a pace at 2 K_two.

    Stairs of 0.1 lie on both sides of each edge. Of the last row fore and hind legs are alike on average,
    which keeps the lost gait for longer.
    """
    model = gs.load_job(EXAMPLES / "four_legs_hysteresis.yaml").model
    each = {"K_two": [0.1, 0.2, 0.2], "bias_3": [3e-4, 3e-4, -1e-4], "bias_4": [7e-4, 7e-4, 2e-4]}
    run = gs.Staircase(parameter="K_fore", path=[0.55, -0.55, 0.55], step=0.1, dwell=60)
    table = gs.sweep(model, zip=each, sigma=0.0, run=run, verify=0).table

    def last(gait: str, number: int) -> list[float]:
        """The value of K_fore on the last stair of each row in a pass that has the gait."""
        stairs = table[(table["gait"] == gait) & (table["pass"] == number)]
        return stairs.groupby("row")["K_fore"].agg("last").tolist()

    trot, pace = last("trot", 0), last("pace", 1)
    np.testing.assert_allclose(trot[:2], [-0.15, -0.35])
    np.testing.assert_allclose(pace[:2], [0.15, 0.35])
    assert trot[2] < -0.4
