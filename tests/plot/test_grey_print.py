"""Gaits are told apart in grey print, by lightness, hatch or marker, and have one look in all figures."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import pytest
from matplotlib.colors import to_hex

from gaitsweep.extension import extensions
from gaitsweep.plot import gait_looks, style, theme
from gaitsweep.status import Outcome

OUTCOMES = ["none", Outcome.NOT_SETTLED, Outcome.FAILED]
EXTENSIONS = [name for name, each in extensions().items() if each.gait_styles]
SPARE = [f"gait {number}" for number in range(8)]


def alike(names: list[str], looks: Mapping[str, str]) -> list[tuple[str, str]]:
    """Pairs of names of nearly the same lightness whose other look is the same."""
    colour = theme.colours(names)
    return [
        (one, other)
        for one, other in itertools.combinations(names, 2)
        if theme.contrast(colour[one], colour[other]) < theme.CONTRAST
        and set(looks[one]) == set(looks[other])
    ]


@pytest.mark.parametrize("names", [*(list(extensions()[each].gait_styles) for each in EXTENSIONS), SPARE])
def test_gaits_of_one_figure_differ_in_lightness_or_in_hatch_and_marker(names: list[str]) -> None:
    hatch = theme.hatches([*names, *OUTCOMES])
    assert alike([*names, *OUTCOMES], hatch) == []
    assert alike([*names, "none"], theme.markers([*names, "none"])) == []
    with style(hatches=False):
        assert not any(theme.hatches(names).values())


def test_hatches_of_many_gaits_compare_few_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[tuple[str, str]] = []
    monkeypatch.setattr(gait_looks, "contrast", lambda *pair: compared.append(pair) or 1.0)
    theme.hatches([f"gait {number}" for number in range(300)])
    assert len(compared) <= 300 * len(gait_looks.SPARE_COLOURS)


def test_gaits_in_colours_of_the_style_differ_in_grey_print() -> None:
    """Crimson and steelblue are close in lightness, and crimson to the blue of the retrograde wave."""
    gaits = ["direct", "source", "retrograde"]
    assert theme.contrast("crimson", "steelblue") < theme.CONTRAST
    with style(colours={"direct": "crimson", "source": "steelblue"}):
        assert alike(gaits, theme.hatches(gaits)) == []
    with style(colours={"source": "#FFFFFF"}):  # far from all others: no hatch is needed
        assert theme.hatches(gaits)["source"] == ""


def test_spare_looks_are_those_that_no_other_gait_has() -> None:
    with style(colours={"gait 0": "#e69f00", "gait 1": "black"}):  # two spare ones, written otherwise
        colours = theme.colours(SPARE)
    assert len({to_hex(colour) for colour in colours.values()}) == len(SPARE)
    gaits = ["direct", "source", "retrograde", *SPARE[:5]]
    assert len(set(theme.markers(gaits).values())) == len(gaits)


def test_contrast_is_the_ratio_of_luminances() -> None:
    assert theme.contrast("#000000", "#FFFFFF") == pytest.approx(21.0)
    assert theme.contrast("#009E73", "#0072B2") == pytest.approx(1.53, abs=0.02)  # source and retrograde


def test_a_gait_of_two_extensions_has_one_look() -> None:
    looks: dict[str, tuple[str, ...]] = {}
    for each in extensions().values():
        for gait, look in each.gait_styles.items():
            assert looks.setdefault(gait, look) == look, gait
