"""Models' own numerics over random parameters, against integrators that share nothing with gaitsweep."""

from __future__ import annotations

import dataclasses
import math

import pytest

from benchmarks.reliability import multilegged_sets, planar_quadruped_sets, waist_quadruped_sets
from benchmarks.reliability.comparison import (
    LOST,
    SENSITIVE,
    SOUND,
    UNKNOWN,
    WRONG,
    Verdict,
    compared,
    counts,
    holds,
    job_of,
    judged,
    ours_of,
)
from benchmarks.reliability.parameter_sets import TURN, Found, Observable, Subject, Values

CHAIN = multilegged_sets.subject(2)
SOMEWHERE = {"psi_1": 1.0, "psi_2": 2.0, "psi_3": 0.001, "landed": 1.0, "t": 30.0}


def found(**changes: float) -> Found:
    return Found("complete", {**SOMEWHERE, **changes})


@pytest.mark.slow
def test_the_chain_with_numerics_left_out() -> None:
    """Parameters over the ranges of the guarantee; the location of events alone is left of the error."""
    verdicts, steps = compared(multilegged_sets.subject, sets=12, seed=1, crossings=2, workers=1)
    assert counts(verdicts) == {SOUND: 12, WRONG: 0, LOST: 0, SENSITIVE: 0, UNKNOWN: 0}
    assert max(verdict.apart for verdict in verdicts) < 1e-5
    assert steps.max() > 1.5 * steps.min(), "each row has its own step"


# Rows 106, 1013 and 2074 of sweeps/multilegged_map.yaml: a leg grazes the ground for less than a step.
GRAZING = (
    (0.6829537936020643, 193.7886011437513, 0.7796184868551791, 0.8253451127558946, 0.1298299155485362,
     1.2934025960497215, 0.1384829882123167),
    (0.9345162936020643, 43.39797614375129, 0.6702434868551791, 0.2878451127558947, 0.5225289972472603,
     4.827694331338239, 3.672774723500834),
    (0.5872506686020643, 27.675319893751293, 0.7616497368551791, 0.8784701127558947, 0.1298299155485362,
     1.2934025960497215, 0.1384829882123167),
)  # fmt: skip


@pytest.mark.slow
def test_touches_shorter_than_a_step_are_seen() -> None:
    """Steps of 18 to 35 ms meet touches of a few ms, as the reference does."""
    names = ("m_B", "kappa", "beta", "omega", "psi_1", "psi_2", "psi_3")
    sets: list[Values] = [dict(zip(names, row, strict=True)) for row in GRAZING]
    subject = multilegged_sets.subject(4)
    ours = ours_of(subject, job_of(subject, sets, 4), 4)
    theirs = [subject.reference(values, False) for values in sets]
    apart = [subject.distance(a, b, v) for a, b, v in zip(ours, theirs, sets, strict=True)]
    assert max(apart) < 1e-3


def stiffer(crossings: int) -> Subject:
    """The chain, whose reference has a spring that is stiffer by 5 %."""

    def reference(values: Values, nudge: bool) -> Found:
        return CHAIN.reference({**values, "kappa": 1.05 * values["kappa"]}, nudge)

    return dataclasses.replace(CHAIN, reference=reference)


@pytest.mark.slow
def test_different_springs_are_detected() -> None:
    """A job whose springs differ from the reference's by 5 % does not pass."""
    verdicts, _ = compared(stiffer, sets=6, seed=1, crossings=2, workers=1)
    assert counts(verdicts)[WRONG] >= 4
    assert not holds(verdicts)


@pytest.mark.slow
def test_default_numerics_of_the_planar_quadruped() -> None:
    """The steps equal those of MuJoCo's body up to rounding."""
    verdicts, steps = compared(planar_quadruped_sets.subject, sets=5, seed=4, crossings=2, workers=1)
    assert counts(verdicts)[SOUND] == 5
    assert max(verdict.apart for verdict in verdicts) < 1e-9
    assert steps.max() <= 1e-3


@pytest.mark.slow
def test_the_quadruped_with_a_waist_with_numerics_left_out() -> None:
    verdicts, _ = compared(waist_quadruped_sets.subject, sets=3, seed=2, crossings=2, workers=1)
    assert counts(verdicts)[SOUND] == 3
    assert max(v.apart for v in verdicts if v.outcome == SOUND and v.ours.observed) < 1e-3


@pytest.mark.parametrize(
    ("ours", "theirs", "again", "outcome"),
    [
        (found(), found(), found(), SOUND),
        (found(psi_3=TURN - 0.001), found(), found(), SOUND),  # 0.002 rad apart, around the turn
        (found(psi_1=1.011), found(), found(), WRONG),
        (found(landed=0.0), found(), found(), WRONG),
        (found(t=30.03), found(), found(), WRONG),  # 0.012 rad of a phase
        (Found("failed"), found(), found(), LOST),
        (Found("fell"), found(), found(), WRONG),
        (Found("fell"), Found("fell"), Found("fell"), SOUND),
        (found(), Found("fell"), Found("fell"), WRONG),
        (found(psi_1=1.5), found(), found(psi_1=1.02), SENSITIVE),
        (Found("fell"), found(), Found("fell"), SENSITIVE),
        (found(), Found("failed"), Found("failed"), UNKNOWN),
    ],
)
def test_outcomes(ours: Found, theirs: Found, again: Found, outcome: str) -> None:
    assert judged(CHAIN, {}, ours, theirs, again).outcome == outcome


def test_one_wrong_set_or_too_many_lost_break_the_guarantee() -> None:
    def verdicts(**each: int) -> list[Verdict]:
        nothing = Found("complete")
        return [
            Verdict({}, nothing, nothing, 0.0, math.nan, name) for name, n in each.items() for _ in range(n)
        ]

    assert holds(verdicts(sound=99, lost=1, sensitive=5))
    assert not holds(verdicts(sound=98, lost=2, sensitive=5))
    assert not holds(verdicts(sound=500, wrong=1))


def test_a_scale_makes_an_observable_an_angle() -> None:
    period = Observable(lambda values: 1.0 / values["omega"])
    assert period.apart(2.0, 2.5, {"omega": 0.4}) == pytest.approx(0.2)
    assert Observable(1.0 / TURN, 1.0).apart(-0.499, 0.499, {}) == pytest.approx(0.002 * TURN)
