"""The column `outcome`: a gait, or why there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from gaitsweep.analysis.records import outcome_labels
from gaitsweep.status import Status
from gaitsweep.table import load
from gaitsweep.table.frames import outcomes
from tests.support.toy_directories import fill, open_toy


def test_an_outcome_is_a_gait_or_why_there_is_none() -> None:
    gait = pd.Categorical(["trot", "none", None, "trot", "walk", None], ["walk", "trot", "none"])
    status = pd.Categorical(["settled", "complete", "at_rest", "cycle_limit", "fell", "diverged"])
    result = outcomes(gait, status)
    assert list(result) == ["trot", "none", "none", "not settled", "failed", "failed"]
    assert list(result.categories) == ["walk", "trot", "none", "not settled", "failed"]


def test_outcomes_of_as_many_gaits_as_a_small_code_holds() -> None:
    names = [f"gait {n}" for n in range(127)]
    assert list(outcomes(pd.Categorical(["gait 126"] * 2, names), ["settled", "fell"])) == [
        "gait 126",
        "failed",
    ]


def test_analyses_read_the_column(tmp_path: Path) -> None:
    with open_toy(tmp_path / "toy") as directory:
        fill(directory)
    table = load(tmp_path / "toy")
    assert outcome_labels(table, "gait").tolist() == list(table["outcome"])
    worked_out = outcome_labels(table.drop(columns="outcome"), "gait")
    assert worked_out.tolist() == list(table["outcome"])
    assert outcome_labels(table.drop(columns="status"), "gait").tolist() == list(table["outcome"])
    edited = pd.concat([table.assign(gait="limp"), table], ignore_index=True)
    settled = np.flatnonzero(table["status"] == "settled")
    assert settled.size
    assert set(outcome_labels(edited, "gait").iloc[settled]) == {"limp"}
    # what starts come to by another label is no outcome of the gait
    by_another = table.assign(outcome="a")
    by_another.attrs["outcome_of"] = "attractor"
    np.testing.assert_array_equal(outcome_labels(by_another, "gait"), worked_out)


def test_statuses_in_categories_are_names_or_numbers() -> None:
    numbers = pd.Series([1, 3, 2, None]).astype("category")
    assert Status.SOUND.among(numbers).tolist() == [True, False, False, False]
    names = pd.Series(["settled", "fell", None]).astype("category")
    assert Status.SOUND.among(names).tolist() == [True, False, False]
