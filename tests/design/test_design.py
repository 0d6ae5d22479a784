"""The rows of a design: products, zips, samples and formulas of the axes in `vary`."""

from __future__ import annotations

import dataclasses
import itertools
import tracemalloc
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import qmc

from gaitsweep.contract import Quantity
from gaitsweep.expression import evaluate
from gaitsweep.job import JobError
from tests.support.toy_jobs import EVERY, columns_of, toy
from toy_model import Toy

if TYPE_CHECKING:
    from collections.abc import Sequence

PINNED_RANDOM = [1.7545246278695097, 1.1632804305752058, 1.7360300467738945]
PINNED_SOBOL = [1.7545246281661093, 1.2545246281661093, 1.0045246281661093, 1.5045246281661093]


def test_no_vary_is_one_row() -> None:
    design = toy().design
    assert (design.n_rows, design.at(np.arange(1), design.names), design.groups) == (1, {}, ())
    assert design.values(0, 1)[1]["launch_1"].tolist() == [1.0]
    with pytest.raises(IndexError):
        design.values(0, 2)


LENGTHS = st.lists(st.integers(1, 5), min_size=1, max_size=4)
NAMES = ("mass", "stiffness", "preload", "launch_1")


@given(LENGTHS, st.data())
def test_rows_are_the_product(lengths: list[int], data: st.DataObject) -> None:
    number = st.floats(0.1, 10.0, allow_nan=False)
    axes = [data.draw(st.lists(number, min_size=length, max_size=length)) for length in lengths]
    columns = columns_of(toy(vary=dict(zip(NAMES, axes, strict=False))))
    result = list(zip(*(columns[name].tolist() for name in columns), strict=True))
    assert result == list(itertools.product(*axes))


@given(st.integers(0, 360), st.integers(0, 360))
def test_slices_equal_the_whole(one: int, other: int) -> None:
    start, stop = sorted((one, other))
    design = EVERY.design
    assert design.n_rows == 4 * 3 * 3 * 5 * 2
    whole, part = design.at(np.arange(360), design.names), design.at(np.arange(start, stop), design.names)
    assert list(part) == ["restitution", "mass", "stiffness", "launch_1", "launch_2", "preload", "ceiling"]
    assert all(np.array_equal(part[name], whole[name][start:stop]) for name in whole)
    for all_rows, some in zip(design.values(0, 360), design.values(start, stop), strict=True):
        assert all(np.array_equal(some[name], all_rows[name][start:stop]) for name in all_rows)


@given(st.lists(st.integers(0, 359), max_size=40), st.booleans())
def test_any_rows_are_those_of_the_whole(rows: list[int], unique: bool) -> None:
    chosen = np.array(sorted(set(rows)) if unique else rows, np.int64)
    whole, some = (EVERY.design.at(those, EVERY.design.names) for those in (np.arange(360), chosen))
    assert all(np.array_equal(some[name], whole[name][chosen]) for name in whole)


def test_a_zip_moves_together() -> None:
    columns = columns_of(toy(vary={"preload": [1, 2], "zip": {"mass": [1, 2, 3], "launch_1": [4, 5, 6]}}))
    assert columns["preload"].tolist() == [1, 1, 1, 2, 2, 2]
    assert columns["mass"].tolist() == [1, 2, 3] * 2
    assert columns["launch_1"].tolist() == [4, 5, 6] * 2


def test_lists_of_groups_multiply() -> None:
    zips = [{"mass": [1, 2]}, {"preload": [3, 4, 5], "launch_1": [6, 7, 8]}]
    design = toy(vary={"zip": zips, "sample": [{"n": 2, "of": {"stiffness": [1, 2]}}]}).design
    assert [axis.length for axis in design.groups] == [2, 3, 2]


@pytest.mark.slow
@given(st.floats(0.1, 10), st.floats(0.1, 10), st.integers(2, 40))
def test_spread_axes_are_numpys(low: float, high: float, count: int) -> None:
    axis = [low, high, count]
    spread = {
        "mass": {"linspace": axis},
        "stiffness": {"linspace": axis, "at": "centre"},
        "preload": {"logspace": axis},
    }
    columns = columns_of(toy(vary={"zip": spread}))
    ends, centre, ratios = (columns[name] for name in spread)
    assert ends == pytest.approx(np.linspace(low, high, count), rel=1e-14)
    assert (ends[0], ends[-1]) == (low, high)
    edges = np.linspace(low, high, count + 1)
    assert centre == pytest.approx((edges[1:] + edges[:-1]) / 2, rel=1e-14)
    assert ratios == pytest.approx(np.geomspace(low, high, count), rel=1e-12)
    assert (ratios[0], ratios[-1]) == (low, high)


@pytest.mark.parametrize("count", [24, 1000, 10_000])
def test_whole_steps_are_whole(count: int) -> None:
    """A seed of 12.999999999999998 would draw the numbers of seed 12."""
    seeds = columns_of(toy(vary={"mass": {"linspace": [1, count, count]}}))["mass"]
    np.testing.assert_array_equal(seeds, np.arange(count) + 1.0)


@pytest.mark.slow
@given(st.sampled_from(["random", "latin_hypercube", "sobol"]), st.integers(0, 1000), st.integers(1, 300))
def test_drawn_points_fill_their_box(method: str, seed: int, count: int) -> None:
    of = {"mass": [1, 2], "preload": [3, 7]}
    columns = columns_of(toy(vary={"sample": {"n": count, "seed": seed, "method": method, "of": of}}))
    assert all(((low <= columns[name]) & (columns[name] < high)).all() for name, (low, high) in of.items())
    swapped = dict(reversed(of.items()))
    again = columns_of(toy(vary={"sample": {"n": count, "seed": seed, "method": method, "of": swapped}}))
    if method == "latin_hypercube":
        parts = [
            np.floor((columns[name] - low) / (high - low) * count + 1e-9) for name, (low, high) in of.items()
        ]
        assert all(sorted(part) == list(range(count)) for part in parts)
    if method != "sobol":  # each name has a stream of its own, whatever stands beside it
        assert all(np.array_equal(columns[name], again[name]) for name in of)


def test_random_points_are_pinned() -> None:
    """Pinned numbers, so that no version of NumPy or SciPy changes a job's rows unnoticed."""
    random = columns_of(toy(vary={"mass": {"random": [1, 2, 3], "seed": 7}}))["mass"]
    sobol = columns_of(toy(vary={"mass": {"sobol": [1, 2, 4], "seed": 7}}))["mass"]
    assert random.tolist() == PINNED_RANDOM
    assert sobol.tolist() == PINNED_SOBOL


def test_draws_depend_on_the_name_and_the_seed() -> None:
    def drawn(name: str, seed: int) -> list[float]:
        return columns_of(toy(vary={name: {"random": [0.1, 0.9, 4], "seed": seed}}))[name].tolist()

    assert drawn("mass", 0) != drawn("preload", 0)
    assert drawn("mass", 0) != drawn("mass", 1)


def test_sobol_and_latin_hypercube_are_more_even_than_random() -> None:
    def discrepancy(method: str) -> float:
        of = {"mass": [1, 2], "preload": [1, 2]}
        columns = columns_of(toy(vary={"sample": {"n": 256, "method": method, "of": of}}))
        return float(qmc.discrepancy(np.column_stack([columns["mass"] - 1, columns["preload"] - 1])))

    # About 4e-5 against 1e-3 at 256 points of a square: a broken shift would lose the factor of ten.
    assert discrepancy("sobol") < 0.1 * discrepancy("random")
    assert discrepancy("latin_hypercube") < 0.5 * discrepancy("random")


def test_memory_does_not_grow_with_the_rows() -> None:
    vary = {name: {"linspace": [1, 2, 1000]} for name in ("mass", "stiffness", "launch_1")}
    tracemalloc.start()
    design = toy(vary=vary).design
    part = design.at(np.arange(10**9 - 3, 10**9), design.names)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert design.n_rows == 10**9
    assert part["launch_1"].tolist() == pytest.approx([2 - 2 / 999, 2 - 1 / 999, 2])
    assert peak < 20e6  # bytes; the rows themselves would take 24e9


def test_combinations_of_names_are_rows() -> None:
    vary = {"mass": [1, 2], "zip": {"stiffness": [3, 4, 5], "preload": [1, 1, 1]}, "launch_1": ["mass", 2]}
    design = toy(vary=vary).design
    rows, count = design.combinations(["stiffness", "mass"], 10)
    assert (rows.tolist(), count) == ([0, 2, 4, 6, 8, 10], 6)
    assert design.combinations(["launch_1"], 3)[0].tolist() == [0, 1, 7]
    assert design.combinations(["ceiling"], 10)[0].tolist() == [0]


def test_large_formulas_are_checked_block_by_block() -> None:
    """With too many combinations to try beforehand, the block with the first bad row is refused."""
    vary = {"mass": {"linspace": [1, 2, 2000]}, "launch_1": {"linspace": ["2-mass", 3, 2000]}}
    design = toy(vary=vary).design
    design.values(0, 10)
    with pytest.raises(JobError, match=r"launch_1 is 0 in row 3998000, but must be above 0"):
        design.values(3_998_000, 4_000_000)


def test_formulas_follow_varied_parameters() -> None:
    design = toy(params={"ceiling": "100*kick"}, vary={"stiffness": [4, 16]}).design
    params, _ = design.values(0, 2)
    assert params["kick"].tolist() == [0.5, 1.0]
    assert params["ceiling"].tolist() == [50.0, 100.0]
    assert design.derived == {"kick": "0.25*sqrt(stiffness/mass)", "ceiling": "100*kick"}


def test_formulas_are_evaluated_after_what_they_use() -> None:
    """Directly or through another formula; `ceiling` is asked for before the `kick` that it needs."""
    design = toy(params={"ceiling": "100*kick", "preload": "mass/2", "restitution": 0.5}).design
    assert tuple(design.following("stiffness")) == ("kick", "ceiling")
    assert set(design.following("mass")) == {"kick", "ceiling", "preload"}
    assert tuple(design.following("kick")) == ("ceiling",)
    assert not design.following("restitution")


def test_formulas_may_use_the_structure() -> None:
    design = toy(structure={"N": 2}, params={"mass": "N/4"}, start={"launch_1": "N*launch_2"}).design
    assert design.values(0, 1)[0]["mass"].tolist() == [0.5]
    assert design.values(0, 1)[1]["launch_1"].tolist() == [2.0]
    assert design.derived["mass"] == "2.0/4"


@dataclasses.dataclass(frozen=True)
class Shifted(Toy):
    c: float = dataclasses.field(default=-2.0, metadata={"low": -9.0})
    n: int = dataclasses.field(default=4, metadata={"later": True})
    spacing: float = dataclasses.field(default_factory=lambda: 0.5)
    lookup: Sequence[int] | None = None  # a name that only type checkers know


def test_formulas_may_use_later_fields_at_their_default_and_defaults_of_factories() -> None:
    job = toy(model=f"{__name__}:Shifted", params={"mass": "n*spacing"})
    assert job.design.values(0, 1)[0]["mass"].tolist() == [2.0]
    assert "n" not in job.structure


def test_a_field_of_a_type_that_jobs_cannot_write_is_refused() -> None:
    with pytest.raises(JobError, match=r"structure.lookup has the type Sequence.*int, float or str"):
        toy(model=f"{__name__}:Shifted", structure={"lookup": 3})


def test_a_negative_number_of_the_structure_keeps_its_sign_in_a_formula() -> None:
    design = toy(model=f"{__name__}:Shifted", params={"ceiling": "-c**3*stiffness/2 - c"}).design
    ceiling = design.values(0, 1)[0]["ceiling"].item()
    assert evaluate(design.derived["ceiling"], {"stiffness": 4.0}) == ceiling == 18.0


def test_a_row_that_a_design_lacks_is_refused() -> None:
    design = toy(vary={"restitution": [0.1, 0.2]}).design
    assert design.row(1)["restitution"] == 0.2
    for number in (-1, 2):
        with pytest.raises(IndexError, match="has 2 rows"):
            design.row(number)


class Turning(Toy):
    @property
    def initial_conditions(self) -> tuple[Quantity, ...]:
        return tuple(
            dataclasses.replace(q, unit="rad", circular=True, low=-7.0) for q in super().initial_conditions
        )


@pytest.mark.parametrize(
    ("axis", "closed"),
    [
        ({"linspace": ["-pi", "pi", 8], "at": "centre"}, True),
        ({"linspace": ["pi", "-pi", 8], "at": "centre"}, True),
        ({"linspace": ["pi/4", "2*pi", 8]}, True),
        ({"linspace": ["-pi", "pi", 8]}, False),
        ({"linspace": [1, 1, 1]}, False),
        ({"linspace": ["-pi", "pi/2", 8], "at": "centre"}, False),
    ],
)
def test_the_cells_of_one_turn_are_closed(axis: dict[str, object], closed: bool) -> None:
    assert toy(model=f"{__name__}:Turning", vary={"launch_1": axis}).design.grids["launch_1"].closed == closed
