"""Verdicts of claims from their fields and the measured values."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError

from gaitsweep.claims.claims_and_verdicts import Claim, ClaimVerdict, in_turn_of, verdict
from gaitsweep.claims.measures import Angle

REPRODUCED, NOT, OPEN = ClaimVerdict.reproduced, ClaimVerdict.not_reproduced, ClaimVerdict.open_constants


def claim(**fields: Any) -> Claim:
    given = {"id": "one", "where": "Fig. 1", "claim": "It is so.", "measure": "value", "because": "read off"}
    return Claim.model_validate(given | fields)


@pytest.mark.parametrize(
    ("fields", "ours", "expected"),
    [
        ({"paper": 0.43, "tolerance": 0.01}, 0.4399, REPRODUCED),
        ({"paper": 0.43, "tolerance": 0.01}, 0.4401, NOT),
        ({"paper": 0.43, "tolerance": 0.01}, math.nan, NOT),
        ({"paper": 0.43, "tolerance": 0.01}, "0.43", NOT),
        ({"paper": 0.35, "tolerance": 0.01}, 0.36, REPRODUCED),  # on the bound, but for rounding
        ({"paper": "below 0.3", "below": 0.3}, 0.1 + 0.2, REPRODUCED),
        ({"paper": 0.1, "tolerance": 0.1}, -1e-17, REPRODUCED),
        ({"paper": "above 0", "above": 0}, -1e-17, NOT),
        ({"paper": 3, "tolerance": 0}, 3, REPRODUCED),
        ({"paper": [1, 2], "tolerance": 0.1}, [1.05, 1.95], REPRODUCED),
        ({"paper": [1, 2], "tolerance": 0.1}, [1.05, 1.85], NOT),
        ({"paper": [1, 2], "tolerance": 0.1}, [1.0], NOT),
        ({"paper": [1, 2], "tolerance": 0.1}, 1.0, NOT),
        ({"paper": "grows with f", "above": 0}, 0.1, REPRODUCED),
        ({"paper": "grows with f", "above": 0}, -0.1, NOT),
        ({"paper": "grows with f", "above": 0}, math.nan, NOT),
        ({"paper": "about one", "between": [0.9, 1.1]}, [0.95, 1.05], REPRODUCED),
        ({"paper": "about one", "between": [0.9, 1.1]}, [0.95, 1.15], NOT),
        ({"paper": "about one", "between": [0.9, 1.1], "below": 1.0}, 1.05, NOT),
        ({"paper": "about one", "between": [0.9, 1.1]}, [], NOT),
        ({"paper": ["walk", "trot"]}, ["walk", "trot"], REPRODUCED),
        ({"paper": ["walk", "trot"]}, ["trot", "walk"], NOT),
        ({"paper": "a trot at first", "equals": "trot"}, "trot", REPRODUCED),
        ({"paper": "trot"}, ["trot"], NOT),
        ({"paper": 3.1, "tolerance": 0.05, "open": "the gains"}, 2.87, OPEN),
        ({"paper": 3.1, "tolerance": 0.05, "open": "the gains"}, 3.08, REPRODUCED),
        ({"paper": "left open", "above": 3, "asked": True}, 6, ClaimVerdict.answered),
        ({"paper": "left open", "above": 3, "asked": True}, 1, NOT),
        ({"paper": 1.0, "tolerance": 0, "definition": "a default"}, 1.0, ClaimVerdict.definition),
        ({"paper": 1.0, "tolerance": 0, "definition": "a default"}, 1.1, NOT),
    ],
)
def test_verdict(fields: dict[str, Any], ours: Any, expected: ClaimVerdict) -> None:
    assert verdict(claim(**fields), ours) is expected


@pytest.mark.parametrize(
    ("fields", "ours", "turned"),
    [
        ({"paper": 0, "tolerance": 0.1}, Angle(6.25), 6.25 - math.tau),
        ({"paper": 6.2, "tolerance": 0.1}, Angle(-0.1), math.tau - 0.1),
        ({"paper": 3, "tolerance": 0.1}, Angle(6.1), 6.1),
        ({"paper": "in phase", "between": [-1, 1]}, Angle(6.25), 6.25 - math.tau),
        ({"paper": "in phase", "below": 1}, Angle(6.25), 6.25),
        ({"paper": 0, "tolerance": 0.1}, 6.25, 6.25),
        ({"paper": "a word"}, Angle(6.25), 6.25),
        ({"paper": [0, 1], "tolerance": 0.1}, Angle(6.25), 6.25),
    ],
)
def test_an_angle_is_in_the_turn_of_what_the_claim_allows(
    fields: dict[str, Any], ours: float, turned: float
) -> None:
    assert in_turn_of(claim(**fields), ours) == pytest.approx(turned)


@pytest.mark.parametrize("bound", [{"above": math.nan}, {"below": math.inf}, {"between": [0, math.nan]}])
def test_a_bound_is_a_finite_number(bound: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="finite"):
        claim(paper="about one", **bound)


@pytest.mark.parametrize(
    "fields",
    [
        {"paper": True, "tolerance": 0.1},
        {"paper": [1.0, True], "tolerance": 0.1},
        {"paper": [1.0, "two"], "tolerance": 0.1},
        {"paper": 1.0, "tolerance": True},
        {"paper": "about one", "between": [False, 2.0]},
        {"paper": "about one", "above": True},
    ],
)
def test_a_boolean_is_no_number(fields: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="must be a number"):
        claim(**fields)


def test_quick_replaces_the_bound() -> None:
    one = claim(paper=0.43, tolerance=0.01, quick={"tolerance": 0.05})
    quick = one.as_quick()
    assert quick is not None
    assert verdict(one, 0.46) is NOT
    assert verdict(quick, 0.46) is REPRODUCED
    between = claim(paper=0.43, tolerance=0.01, quick={"between": [0.3, 0.5]}).as_quick()
    assert between is not None
    assert verdict(between, 0.31) is REPRODUCED
    assert claim(paper=1, tolerance=0, quick=False).as_quick() is None
