"""Curves of folds in two parameters, and their cusps, on maps whose folds are known in closed form."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.fold_curves import fold_curves
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.engine.poincare.maps import Coordinates, Values
from gaitsweep.errors import ArgumentError

STEPS = ArclengthSteps(first=0.02, longest=0.05, shortest=1e-4, most=120)


def cusp(values: Values, x: Coordinates) -> Coordinates:
    """Folds where 27 r^2 = 4 a^3, x = +-sqrt(a/3); cusp at r = a = 0."""
    return x + 0.3 * (values["r"] + values["a"] * x - x**3)


def coupled(values: Values, x: Coordinates) -> Coordinates:
    """The same, sheared and shifted, with a second direction that contracts; cusp at r = 0.3, a = -.2."""
    u, y = x[0] - x[1], x[1]
    u_next = u + 0.3 * ((values["r"] - 0.3) + (values["a"] + 0.2) * u - u**3)
    y_next = 0.4 * y + 0.1 * u**2
    return jnp.stack([u_next + y_next, y_next])


def conserving(values: Values, x: Coordinates) -> Coordinates:
    """The cusp's map in x - y; x + y stays what it is."""
    u = 0.5 * (x[0] - x[1])
    moved = 0.3 * (values["r"] + values["a"] * u - u**3)
    return jnp.stack([x[0] + moved, x[1] - moved])


CUSP = PlainMap(cusp, ("x",), (("r", 0.0), ("a", 1.0)))
COUPLED = PlainMap(coupled, ("x", "y"), (("r", 0.3), ("a", 0.8)))
CONSERVING = PlainMap(
    conserving, ("x", "y"), (("r", 0.0), ("a", 1.0)), invariants=(("sum", lambda values, x: x[0] + x[1]),)
)
RANGES = {"r": (-1.0, 1.0), "a": (-0.5, 1.5)}


def test_a_fold_curve_passes_its_cusp() -> None:
    """From the fold at a = 1 through the cusp to the other side the curve is 27 r^2 = 4 a^3."""
    result = fold_curves(
        CUSP, CUSP.points([[1.0]]), {}, parameters=("r", "a"), within=RANGES, begin={"r": 0.0, "a": 1.0},
        to_fold=-1, towards=-1, steps=STEPS,
    )  # fmt: skip
    r, a, x = (result[name].to_numpy(float) for name in ("r", "a", "x"))
    np.testing.assert_allclose(27.0 * r**2, 4.0 * a**3, atol=1e-6)
    np.testing.assert_allclose(3.0 * x**2, a, atol=1e-5)
    assert r[0] < 0.0 < r[-1]
    tip = result.query("special == 'cusp'")
    assert len(tip) == 1
    np.testing.assert_allclose(tip[["r", "a"]].to_numpy(float), [[0.0, 0.0]], atol=1e-6)
    assert result["end"].iloc[-1] == "range"
    assert set(result["end"].iloc[:-1]) == {""}


@pytest.mark.parametrize("sign", [1, -1])
def test_the_cusp_of_a_map_of_the_plane(sign: int) -> None:
    within = {"r": (-0.7, 1.3), "a": (-0.7, 1.3)}
    start = COUPLED.points([[0.1 / 0.6 + 1.0, 0.1 / 0.6]] if sign < 0 else [[0.1 / 0.6 - 1.0, 0.1 / 0.6]])
    result = fold_curves(
        COUPLED, start, {}, parameters=("r", "a"), within=within, begin={"r": 0.3, "a": 0.8},
        to_fold=sign, towards=-1, steps=STEPS,
    )  # fmt: skip
    r, a = result["r"].to_numpy(float) - 0.3, result["a"].to_numpy(float) + 0.2
    np.testing.assert_allclose(27.0 * r**2, 4.0 * a**3, atol=1e-6)
    tip = result.query("special == 'cusp'")
    np.testing.assert_allclose(tip[["r", "a"]].to_numpy(float), [[0.3, -0.2]], atol=1e-6)


def test_with_a_conserved_quantity() -> None:
    result = fold_curves(
        CONSERVING, CONSERVING.points([[1.2, -0.8]]), {}, parameters=("r", "a"), within=RANGES,
        begin={"r": 0.0, "a": 1.0}, to_fold=-1, towards=-1, fix=("sum",), steps=STEPS,
    )  # fmt: skip
    np.testing.assert_allclose(result["x"] + result["y"], 0.4, atol=1e-9)
    tip = result.query("special == 'cusp'")
    np.testing.assert_allclose(tip[["r", "a"]].to_numpy(float), [[0.0, 0.0]], atol=1e-6)


def test_no_fold_and_refusals() -> None:
    """At a = -1 the branch has no fold; a curve takes two parameters and a range of each."""
    common = {"to_fold": -1, "towards": -1, "steps": STEPS}
    result = fold_curves(
        CUSP, CUSP.points([[0.0]]), {}, parameters=("r", "a"), within={"r": (-1, 1), "a": (-2, 1)},
        begin={"r": 0.0, "a": -1.0}, **common,
    )  # fmt: skip
    assert result["end"].tolist() == ["no_fold"]
    begin = {"r": 0.0, "a": 1.0}
    with pytest.raises(ArgumentError, match="needs two"):
        fold_curves(CUSP, CUSP.points([[1.0]]), {}, parameters=("r", "r"), within=RANGES, begin=begin)
    with pytest.raises(ArgumentError, match="no range for a"):
        fold_curves(CUSP, CUSP.points([[1.0]]), {}, parameters=("r", "a"), within={"r": (0, 1)}, begin=begin)


@pytest.mark.slow
def test_the_fold_of_the_trot_agrees_with_staircases() -> None:
    """At f = 2.6 Hz it lies between the last beta at which holds of 120 s keep the trot and the next."""
    mapping = gs.return_map(gs.models.WaistQuadruped(), f=2.55, beta=0.7515, numerics={"dt": 3e-4})
    result = fold_curves(
        mapping.mapping, mapping.settled({"delta_13": 2.79}, cycles=60), {}, parameters=("f", "beta"),
        within={"f": (2.3, 3.0), "beta": (0.75, 0.754)}, begin={"f": 2.55, "beta": 0.7515},
        steps=ArclengthSteps(first=0.1, longest=0.1, shortest=1e-3, most=3),
    )  # fmt: skip
    f, beta = result["f"].to_numpy(float), result["beta"].to_numpy(float)
    assert np.all(np.diff(beta) > 0.0)
    assert np.all(np.diff(f) < 0.0)
    assert 0.7520 < np.interp(-2.6, -f, beta) < 0.75225
