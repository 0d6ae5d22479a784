"""Random hybrid models beside their solutions, which share no code with the engine."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks.reliability.events import SILENT, drawn, shares, verdicts_on
from benchmarks.reliability.random_events import FAMILIES
from benchmarks.reliability.random_events.family import Case, Family, Solution, differences

BY_NAME = {family.name: family for family in FAMILIES}
BOUNCING = BY_NAME["bouncing"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "bouncing",
        "start on a floor",
        "accumulating impacts",
        "balls together",
        "pair of cells",
        "clocks that meet",
        "oscillators",
        "narrow bumps",
    ],
)
def test_no_model_is_wrong_in_silence(name: str) -> None:
    family = BY_NAME[name]
    verdicts = verdicts_on(family, drawn(family, 4, seed=7), {})
    assert [verdict.message for verdict in verdicts if verdict.outcome == SILENT] == []


@pytest.mark.slow
def test_a_different_restitution_is_detected() -> None:
    """A solution whose restitution differs by 1e-4 does not pass."""

    def other(case: Case) -> Solution:
        return BOUNCING.exact(
            dataclasses.replace(case, values={**case.values, "rest": case.values["rest"] + 1e-4})
        )

    family = dataclasses.replace(BOUNCING, exact=other, jacobian=False)
    verdicts = verdicts_on(family, drawn(family, 3, seed=7), {})
    assert [verdict.outcome for verdict in verdicts] == [SILENT] * 3


def test_the_independent_solutions() -> None:
    """The search for events that families share, and the differences, beside a ball in closed form."""
    (case,) = drawn(BOUNCING, 1, seed=7)
    p = {**case.values, "lift": 0.0, "rest": 0.5}
    closed = BOUNCING.exact(dataclasses.replace(case, values=p))
    still = {"base": p["y_0"], "size": 0.0, "omega": 1.0, "phi_0": 0.0}
    searched = BY_NAME["shaken floor"].exact(dataclasses.replace(case, values={**p, **still}))
    np.testing.assert_allclose(searched.columns["t"], closed.columns["t"], rtol=1e-12)
    np.testing.assert_allclose(searched.columns["v_n"], closed.columns["v_n"], rtol=1e-11)

    fall = np.sqrt(p["v_0"] ** 2 + 2.0 * p["g"] * (p["h_0"] - p["y_0"]))
    slopes = differences(BOUNCING, dataclasses.replace(case, values=p), ["h", "v"], {})[1]
    np.testing.assert_allclose(slopes, [p["rest"] * p["g"] / fall, p["rest"] * p["v_0"] / fall], rtol=1e-9)


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_families_are_reproducible_from_one_seed(family: Family) -> None:
    first, again = (drawn(family, 1, seed=3) for _ in range(2))
    assert first == again
    for case in first:
        for name, column in family.exact(case).columns.items():
            assert np.all(np.isfinite(column)), name


def test_three_hundred_models() -> None:
    assert sum(shares(list(FAMILIES), 300)) == 300
    assert min(shares(list(FAMILIES), 300)) >= 3
