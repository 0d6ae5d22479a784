"""Indices of sensitivity against closed forms, for outputs that are known functions of the sets."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.sensitivity_methods import Method, Output, SensitivityDesign, design_of, indices
from response_model import COEFFICIENTS, A, B, ishigami, ishigami_indices

NAMES = ["x_1", "x_2", "x_3"]
RANGES = {name: FreeParameter(low=-np.pi, high=np.pi) for name in NAMES}


def designed(
    method: Method, n: int | None, ranges: dict[str, FreeParameter] = RANGES, seed: int = 0
) -> SensitivityDesign:
    return design_of(method, n, seed, ranges, {"x_1": 1.0, "x_2": 0.5, "x_3": -2.0})


def points(design: SensitivityDesign) -> np.ndarray:
    return np.stack([design.sets[name] for name in NAMES], axis=1)


def column(found: pd.DataFrame, index: str, field: str = "value", output: str = "y") -> np.ndarray:
    """Return a field of an index by the order of NAMES."""
    chosen = found[(found["index"] == index) & (found["output"] == output)].set_index("parameter")
    return chosen.loc[NAMES, field].to_numpy()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_sobol_indices_of_ishigami(seed: int) -> None:
    design = designed("sobol", 2048, seed=seed)
    result = indices(design, {"y": Output(ishigami(points(design)))}, seed)
    assert set(result["method"]) == {"sobol"}
    for index, exact in zip(("S1", "ST"), ishigami_indices(), strict=True):
        half = column(result, index, "confidence").astype(float)
        assert (np.abs(column(result, index).astype(float) - exact) <= 1.5 * half + 1e-3).all()
        assert (half < 0.1).all()
    assert list(dict.fromkeys(result["parameter"])) == NAMES  # by ST: 0.56, 0.44, 0.24
    assert np.all(result["rows"] == 2048 * 5)


def test_intervals_are_seeded_and_leave_numpys_generator_alone() -> None:
    design = designed("sobol", 64)
    output = {"y": Output(ishigami(points(design)))}
    np.random.seed(5)
    first = indices(design, output, 0)
    drawn = np.random.random()
    np.random.seed(7)
    pd.testing.assert_frame_equal(first, indices(design, output, 0))
    np.random.seed(5)
    assert np.random.random() == drawn
    assert np.any(indices(design, output, 1)["confidence"] != first["confidence"])


def test_morris_of_a_linear_function_gives_its_coefficients() -> None:
    design = designed("morris", 6)
    y = points(design) @ COEFFICIENTS
    result = indices(design, {"y": Output(y, "N")}, 0)
    exact = 2.0 * np.pi * np.array(COEFFICIENTS)  # the effect of the whole range
    np.testing.assert_allclose(column(result, "mu").astype(float), exact, rtol=1e-12)
    np.testing.assert_allclose(column(result, "mu_star").astype(float), np.abs(exact), rtol=1e-12)
    np.testing.assert_allclose(column(result, "sigma").astype(float), 0.0, atol=1e-12)
    assert list(dict.fromkeys(result["parameter"])) == ["x_2", "x_1", "x_3"]
    assert set(result["unit"]) == {"N"}


def test_morris_takes_whole_trajectories() -> None:
    design = designed("morris", 6)
    y = points(design) @ COEFFICIENTS
    y[[1, 9]] = np.nan  # of trajectories 0 and 2
    result = indices(design, {"y": Output(y)}, 0)
    np.testing.assert_allclose(column(result, "mu").astype(float), 2.0 * np.pi * np.array(COEFFICIENTS))
    assert np.all(result["rows"] == 16)
    assert set(result["note"]) == {"4 of 6 trajectories are whole"}
    y[22] = np.nan
    result = indices(design, {"y": Output(y)}, 0)
    assert np.all(result["value"].isna())
    assert np.all(result["confidence"].isna())
    assert set(result["note"]) == {"3 of 6 trajectories are whole, and 4 are needed"}


def test_one_at_a_time_gives_changes_and_elasticities() -> None:
    """Y = x_1^2 x_2: at (1, 0.5), ranges to both sides of it, and one whose middle is elsewhere."""
    ranges = {
        "x_1": FreeParameter(low=0.9, high=1.1),
        "x_2": FreeParameter(low=0.5, high=1.0),
        "x_3": FreeParameter(low=-3.0, high=-1.0),
    }
    design = designed("one_at_a_time", None, ranges)
    x = points(design)
    assert len(x) == 1 + 2 + 2 + 2  # a middle or an end that is the job's own value is not run again
    result = indices(design, {"y": Output(x[:, 0] ** 2 * x[:, 1])}, 0)
    np.testing.assert_allclose(column(result, "change_low").astype(float), [-0.095, 0, 0], atol=1e-15)
    np.testing.assert_allclose(column(result, "change_high").astype(float), [0.105, 0.5, 0], atol=1e-15)
    middles = result[result["index"] == "change_middle"].set_index("parameter")["value"]
    assert dict(middles) == {"x_2": 0.25}
    np.testing.assert_allclose(column(result, "elasticity").astype(float), [2.0, 1.0, 0.0], atol=1e-14)
    assert np.all(result["confidence"].isna())


def test_one_at_a_time_names_missing_sets() -> None:
    design = designed("one_at_a_time", None)
    y = points(design) @ COEFFICIENTS
    y[1] = np.nan  # the low end of x_1
    result = indices(design, {"y": Output(y)}, 0).set_index(["parameter", "index"])
    assert result.loc[("x_1", "change_low"), "note"] == "no value at the low end"
    assert result.loc[("x_1", "elasticity"), "note"].startswith("no value at one of the ends")
    assert np.isfinite(result.loc[("x_1", "change_high"), "value"])
    y[0] = np.nan
    result = indices(design, {"y": Output(y)}, 0)
    assert np.all(result["value"].isna())
    assert result["note"].str.contains("the job's own values").all()


def _first_order_where_sound(limit: float) -> np.ndarray:
    """S1 (3,) of Ishigami's function for x_1 from -pi to `limit`: moments over a grid, no draws."""
    x_1 = np.linspace(-np.pi, limit, 20_001)
    s = np.sin(x_1)
    weight = 1.0 + B * np.pi**4 / 5.0  # the mean over x_3
    square = 1.0 + 2.0 * B * np.pi**4 / 5.0 + B**2 * np.pi**8 / 9.0  # and of its square
    mean, mean_square = np.trapezoid(s, x_1) / np.ptp(x_1), np.trapezoid(s**2, x_1) / np.ptp(x_1)
    of_2 = A**2 / 8.0
    total = mean_square * square - (mean * weight) ** 2 + of_2
    of_1 = weight**2 * (mean_square - mean**2)
    of_3 = mean**2 * B**2 * (np.pi**8 / 9.0 - np.pi**8 / 25.0)
    return np.array([of_1, of_2, of_3]) / total


def test_gaps_in_a_sobol_design_leave_indices_of_the_sound_rows() -> None:
    design = designed("sobol", 2048)
    x = points(design)
    lost = x[:, 0] > 2.0
    y = np.where(lost, np.nan, ishigami(x))
    result = indices(design, {"y": Output(y), "failures": Output(lost.astype(float))}, 0)
    given = result.loc[result["output"] == "y"]
    assert set(given["method"]) == {"rbd_fast"}
    half = column(result, "S1", "confidence").astype(float)
    exact = _first_order_where_sound(2.0)
    assert (np.abs(column(result, "S1").astype(float) - exact) <= half).all()
    assert (half < 0.1).all()
    assert np.isnan(column(result, "ST").astype(float)).all()
    assert given["note"].str.contains("of 4096 independent rows have a value").all()
    # who fails is known of all rows, and follows from x_1 alone
    assert set(result[result["output"] == "failures"]["method"]) == {"sobol"}
    for index in ("S1", "ST"):
        np.testing.assert_allclose(
            column(result, index, output="failures").astype(float), [1, 0, 0], atol=0.03
        )


def test_too_few_sound_rows_and_constant_outputs_have_no_index() -> None:
    design = designed("sobol", 64)
    y = ishigami(points(design))
    few = y.copy()
    few[::5][20:] = np.nan  # most of the first base points
    few[4::5][:30] = np.nan
    same = np.full(y.size, 3.0)
    gaps = same.copy()
    gaps[1] = np.nan
    rounded = Output(np.mod(1e-16 * y, 2.0 * np.pi), "rad", circular=True)  # the angle 0
    outputs = {"few": Output(few), "same": Output(same), "gaps": Output(gaps), "rounded": rounded}
    result = indices(design, outputs, 0)
    assert np.all(result["value"].isna())
    notes = result.groupby("output")["note"].first().to_dict()
    assert notes["rounded"] == notes["same"]
    assert notes["few"] == "54 of 128 independent rows have a value, and RBD-FAST needs 100"
    assert notes["same"] == "the output is the same in all rows"
    assert notes["gaps"] == "128 of 128 independent rows have a value, and it is the same in all of them"


@pytest.mark.parametrize("method", ["one_at_a_time", "morris", "sobol"])
def test_angles_are_unwrapped(method: Method) -> None:
    """A third of a linear function, less whole turns: the indices are those of the third itself."""
    ranges = {name: FreeParameter(low=-1.0, high=1.0) for name in NAMES}
    n = {"one_at_a_time": None, "morris": 6, "sobol": 64}[method]
    design = design_of(method, n, 0, ranges, {"x_1": 0.1, "x_2": -0.2, "x_3": 0.0})
    third = points(design) @ COEFFICIENTS / 3.0
    assert third.min() < 0.0 < third.max()
    angle = Output(np.mod(third, 2.0 * np.pi), "rad", circular=True)
    result = indices(design, {"y": angle, "line": Output(third, "rad")}, 0)
    of = {name: each.reset_index(drop=True) for name, each in result.groupby("output")}
    same = of["y"]["index"] != "elasticity"
    np.testing.assert_allclose(of["y"]["value"][same], of["line"]["value"][same], atol=1e-12)
    assert of["y"].loc[~same, "value"].isna().all()
    assert not of["y"].loc[same, "note"].any()


def test_angles_all_around_the_circle_are_reported() -> None:
    design = designed("sobol", 64)
    angle = Output(np.mod(3.0 * points(design)[:, 0], 2.0 * np.pi), "rad", circular=True)
    result = indices(design, {"y": angle}, 0)
    assert result["note"].str.contains("all around the circle").all()


def test_changes_of_angles_are_never_cut() -> None:
    design = designed("one_at_a_time", None)
    angle = Output(np.linspace(0.0, 2.0 * np.pi, design.n_rows), "rad", circular=True)
    result = indices(design, {"y": angle}, 0)
    assert not result.loc[result["index"] != "elasticity", "note"].any()


def test_a_start_that_the_model_decides_has_no_elasticity() -> None:
    design = design_of("one_at_a_time", None, 0, {"x_1": RANGES["x_1"]}, {"x_1": np.nan})
    result = indices(design, {"y": Output(np.arange(1.0, 1.0 + design.n_rows))}, 0).set_index("index")
    assert np.isnan(result.loc["elasticity", "value"])
    assert "no value" in result.loc["elasticity", "note"]
