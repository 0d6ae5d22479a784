"""Near misses: the most similar allowed word, and which one of equally similar words."""

from __future__ import annotations

import pytest

from gaitsweep.near_miss import nearest

STARTS = [f"hopf_{axis}_{leg}_0" for axis in "xy" for leg in (1, 2, 3, 4)]


@pytest.mark.parametrize(
    ("word", "near"),
    [
        ("hopf_x_2", "hopf_x_2_0"),
        ("hopf_2_0", "hopf_x_2_0"),
        ("hopf_y", "hopf_y_1_0"),
        ("Hopf_X_3_0", "hopf_x_3_0"),
        ("hopf_x_5_0", "hopf_x_4_0"),
        ("gait", None),
    ],
)
def test_of_equally_similar_words_one_is_near(word: str, near: str | None) -> None:
    """The starts of the oscillators of legs differ in one letter, so that many are equally similar."""
    assert nearest(word, STARTS) == near


def test_the_same_beginning_decides_between_equally_similar_words() -> None:
    assert nearest("leg_x", ["arm_x", "leg_y"]) == "leg_y"
