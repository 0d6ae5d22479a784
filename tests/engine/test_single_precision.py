"""Mixed precision: forces in float32, the state in float64."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.dynamics.single_precision import evaluated_in
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.solver.methods import refusal
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.mechanics import WaistMechanics
from tests.support.sweeping import run_rows, scalars

TABLE = np.linspace(0.1, 0.9, 9).reshape(3, 3)  # float64, as a tree's constants are


def rotated(tree: dict[str, jax.Array], angle: jax.Array) -> dict[str, jax.Array]:
    turned = TABLE @ tree["x"] * jnp.sin(angle)
    return {"x": jnp.where(tree["up"], turned, -turned), "n": tree["n"] + 1}


ARGUMENTS = (
    {"x": jnp.asarray([0.3, -0.2, 0.7]), "up": jnp.asarray(True), "n": jnp.asarray(3)},
    jnp.asarray(1.1),
)


def test_a_function_in_single_precision_rounds_as_single_precision_does() -> None:
    exact = rotated(*ARGUMENTS)
    result = evaluated_in("float32", rotated)(*ARGUMENTS)
    assert result["x"].dtype == jnp.float64
    assert result["n"] == 4
    error = np.abs(result["x"] / exact["x"] - 1.0).max()
    # some roundings of 6e-8; none at all would mean that it was worked out in float64
    assert 1e-9 < error < 1e-6


def test_all_of_it_is_in_single_precision() -> None:
    program = jax.make_jaxpr(evaluated_in("float32", rotated))(*ARGUMENTS)
    for equation in program.eqns:
        if equation.primitive.name != "convert_element_type":
            assert all(getattr(v.aval, "dtype", None) != jnp.float64 for v in equation.outvars), equation


def test_in_float64_it_is_the_function_itself() -> None:
    assert evaluated_in(np.dtype("float64"), rotated) is rotated


def test_a_loop_is_refused() -> None:
    def looped(x: jax.Array) -> jax.Array:
        return jax.lax.while_loop(lambda y: y < 3.0, lambda y: y + 1.0, x)

    with pytest.raises(ValueError, match="while cannot be evaluated in float32"):
        evaluated_in("float32", looped)(jnp.asarray(1.0))


def test_mixed_precision_is_for_steps_of_fixed_length() -> None:
    model = WaistQuadruped()
    assert refusal("semi_implicit", model, "mixed") is None
    assert "Allowed in mixed: semi_implicit" in (refusal("rk4", model, "mixed") or "")
    assert "mixed" in model.precisions
    assert "mixed" not in WaistQuadruped("mjx").precisions + Multilegged().precisions


@pytest.mark.slow
def test_a_foot_is_placed_to_single_precision() -> None:
    """A micrometre of depth in the ground is 0.04 N of some 6 N that a foot bears, so feet need 1e-7 m."""
    model = WaistQuadruped()
    m = scalars(model).mechanics
    q = jnp.asarray(np.random.default_rng(0).uniform(-0.5, 0.5, 16))
    v = jnp.asarray(np.random.default_rng(1).uniform(-1.0, 1.0, 15))
    exact, _ = WaistMechanics.feet(m, q, v)
    found, _ = evaluated_in("float32", WaistMechanics.feet)(m, q, v)
    assert 0.0 < np.abs(found - exact).max() < 1e-7


@pytest.mark.slow
def test_gaits_are_kept_in_mixed_precision() -> None:
    """Rounding at f = 2.6 changes trot and walk by some mrad; the branches are 0.44 rad apart."""
    model, starts = WaistQuadruped(), np.linspace(1.57, 3.46, 16)
    ends = {}
    for precision in ("float64", "mixed"):
        numerics = Numerics(dt=2e-4, method="semi_implicit", precision=precision)
        rows = run_rows(
            model, CrossingRecorder(model, crossings=200), {"delta_13": starts}, params={"f": 2.6},
            numerics=numerics, lanes=16, engine="kernel",
        )  # fmt: skip
        samples = rows.samples.reshape(16, -1, rows.samples.shape[1])
        ends[precision] = samples[:, -50:, 2].mean(axis=1)
        # the first crossings agree to what float32 leaves of a landing's time
        ends[precision + " first"] = samples[:, 1, 2]
    assert np.abs(ends["mixed"] - ends["float64"]).max() < 0.002
    assert np.abs(ends["mixed first"] - ends["float64 first"]).max() < 5e-5
