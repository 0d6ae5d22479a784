"""Newton's method for fixed points of maps, many starts at once."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.analysis.continuation.floquet_multipliers import multipliers
from gaitsweep.analysis.continuation.newton import NewtonOutcome, newton
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.poincare.map_derivatives import BATCH_SIZES
from gaitsweep.engine.poincare.maps import Coordinates, Values
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged


def fold(values: Values, x: Coordinates) -> Coordinates:
    return x + values["r"] - x**2


def pulled(values: Values, x: Coordinates) -> Coordinates:
    """Two angles pulled towards 1 and 6 rad."""
    return x + values["pull"] * jnp.sin(jnp.array([1.0, 6.0]) - x)


FOLD = PlainMap(fold, ("x",), (("r", 0.25),))


def test_stable_and_unstable_fixed_points() -> None:
    """Of x -> x + r - x^2: sqrt(r) and -sqrt(r), multipliers 1 - 2 sqrt(r) and 1 + 2 sqrt(r)."""
    starts = np.array([-3.0, -0.3, 0.2, 4.0])[:, None]
    result = newton(FOLD, FOLD.points(starts), {})
    assert result.converged.all()
    np.testing.assert_allclose(result.points.at[:, 0], [-0.5, -0.5, 0.5, 0.5], atol=1e-9)
    np.testing.assert_allclose(multipliers(result.images.jacobian)[:, 0], [2.0, 2.0, 0.0, 0.0], atol=1e-8)


def test_a_repr_is_short() -> None:
    starts = np.linspace(0.2, 1.0, 500)[:, None]
    result = newton(FOLD, FOLD.points(starts), {})
    assert repr(result) == "FixedPoints(500 converged: [0.5], [0.5], [0.5], ...)"
    assert repr(FOLD.points(np.array([[0.2], [-1.25]]))) == "Points(2: [0.2], [-1.25])"
    assert repr(result.images) == "MapEvaluation(500 of 500 defined)"
    none = newton(FOLD, FOLD.points(starts[:2]), {"r": np.array([0.25, -0.2])})
    assert repr(none).startswith("FixedPoints(1 converged, 1 ")
    assert repr(none).endswith(": [0.5])")


def test_outcomes() -> None:
    """No fixed point at r < 0; a flat residual at x = 0, over which a cycle of the map leads; two that have
    met; a start where the map is not defined; a start that is a fixed point."""
    starts = FOLD.points(np.array([[0.7], [0.0], [0.0], [np.nan], [0.5]]))
    result = newton(FOLD, starts, {"r": np.array([-0.2, 0.25, 0.0, 0.25, 0.25])})
    expected = [
        NewtonOutcome.not_converged,
        NewtonOutcome.converged,
        NewtonOutcome.singular,
        NewtonOutcome.left,
        NewtonOutcome.converged,
    ]
    assert result.outcome.tolist() == expected
    assert all(NewtonOutcome(code).sentence for code in result.outcome)


def test_thousands_of_starts_in_any_number() -> None:
    """Rows do not depend on which others are searched for beside them."""
    count = 20 * BATCH_SIZES[-1] + 7
    starts = np.concatenate([np.linspace(-2.0, -0.2, 640), np.linspace(0.2, 2.0, count - 640)])[:, None]
    radius = np.linspace(0.01, 1.0, count)
    result = newton(FOLD, FOLD.points(starts), {"r": radius})
    assert result.converged.all()
    np.testing.assert_allclose(np.abs(result.points.at[:, 0]), np.sqrt(radius), atol=1e-8)
    some = newton(FOLD, FOLD.points(starts[700:703]), {"r": radius[700:703]})
    np.testing.assert_array_equal(some.points.at, result.points.at[700:703])


def test_angles_are_compared_around_the_circle() -> None:
    mapping = PlainMap(pulled, ("a", "b"), (("pull", 0.5),), angles=("a", "b"))
    result = newton(mapping, mapping.points([[0.8, 0.1], [2 * np.pi + 1.2, 5.5]]), {})
    assert result.converged.all()
    apart = mapping.difference(result.points.at, np.array([[1.0, 6.0]]))
    np.testing.assert_allclose(apart, 0.0, atol=1e-8)


def line(values: Values, x: Coordinates) -> Coordinates:
    """Conserves x + y where nothing leaks, and pulls y towards x^2."""
    pull = 0.5 * (x[1] - x[0] ** 2)
    return jnp.stack([x[0] + pull, x[1] - pull + values["leak"]])


CONSERVING = PlainMap(
    line, ("x", "y"), (("leak", 0.0),), invariants=(("total", lambda values, x: x[0] + x[1]),)
)


def test_conserved_quantities_are_constrained() -> None:
    """The map conserves E = x + y; Newton's equations are singular unless E is constrained."""
    starts = CONSERVING.points([[0.9, 0.8], [0.3, 0.4]])
    alone = newton(CONSERVING, starts, {})
    assert alone.outcome.tolist() == [NewtonOutcome.singular] * 2
    assert alone.fixed.tolist() == [True, True]  # on a line of fixed points
    leaking = newton(CONSERVING, starts, {"leak": 0.01})
    assert leaking.outcome.tolist() == [NewtonOutcome.singular] * 2
    assert not leaking.fixed.any()
    held = newton(CONSERVING, starts, {}, fix=["total"])
    assert held.converged.all()
    total = np.array([1.7, 0.7])
    np.testing.assert_allclose(held.points.at[:, 0], -0.5 + np.sqrt(0.25 + total), atol=1e-9)
    np.testing.assert_allclose(held.drift, 0.0, atol=1e-12)
    # of two multipliers the neutral one is left out
    gradients = held.images.conserved_jacobian
    x = held.points.at[:, 0]
    np.testing.assert_allclose(multipliers(held.images.jacobian)[:, 0], 1.0, atol=1e-9)
    np.testing.assert_allclose(
        multipliers(held.images.jacobian, gradients)[:, 0], 1.0 - 0.5 * (1.0 + 2.0 * x), atol=1e-9
    )
    assert multipliers(np.empty((0, 2, 2)), np.empty((0, 1, 2))).shape == (0, 1)
    given = newton(CONSERVING, starts, {}, fix={"total": 0.75})
    np.testing.assert_allclose(given.points.at[:, 0], 0.5, atol=1e-9)


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_the_unit_of_a_conserved_quantity_does_not_matter(unit: float) -> None:
    mapping = PlainMap(line, ("x", "y"), invariants=(("total", lambda values, x: unit * (x[0] + x[1])),))
    held = newton(
        mapping, mapping.points([[0.9, 0.8], [0.3, 0.4]]), {"leak": 0.0}, fix={"total": 0.75 * unit}
    )
    assert held.converged.all()
    np.testing.assert_allclose(held.points.at[:, 0], 0.5, atol=1e-9)


def test_nearly_conserved_quantities_drift() -> None:
    """A cycle adds 0.01 to E, so there is no fixed point; with E constrained the drift is 0.01."""
    held = newton(CONSERVING, CONSERVING.points([[0.9, 0.8]]), {"leak": 0.01}, fix=["total"])
    assert held.converged.all()
    np.testing.assert_allclose(held.drift, 0.01, atol=1e-12)


def test_an_unknown_conserved_quantity_is_refused() -> None:
    with pytest.raises(ValueError, match="did you mean total"):
        newton(CONSERVING, CONSERVING.points([[0.9, 0.8]]), {}, fix=["totale"])


@pytest.mark.slow
def test_gaits_of_the_chain_at_fixed_E() -> None:
    """The three gaits as fixed points, from three cycles after a start near each.

    On the model's page they are simulated: 1.1301 0.9842 1.4960, 3.959 5.300 5.291, 1.130 1.102 5.282, to
    the digits given; Newton stays within 0.005 of them since E is held where it was after three cycles.
    """
    mapping = BatchedReturnMap(Multilegged(), numerics=Numerics(dt=32e-3, method="propagator6"))
    starts = {"psi_1": [1.13, 3.97, 1.13], "psi_2": [0.98, 5.29, 1.10], "psi_3": [1.50, 5.29, 5.28]}
    points, _ = mapping.settled({k: np.array(v) for k, v in starts.items()}, {}, 3)
    result = newton(mapping, points, {}, fix=["E"])
    assert result.converged.all()
    simulated = [[1.1301, 0.9842, 1.4960], [3.959, 5.300, 5.291], [1.130, 1.102, 5.282]]
    np.testing.assert_allclose(result.points.at[:, :3], simulated, atol=0.005)
    # what is left of neutral drift on the source branch is 1e-4 rad a cycle
    assert np.all(np.abs(result.drift) < 1.2e-4)
    assert np.all(np.abs(result.drift[:2]) < 1e-8)
    # without it the first two lie on lines, on which E drifts by more than the tolerance or by less
    alone = newton(mapping, result.points[np.arange(2)], {})
    assert alone.outcome.tolist() == [NewtonOutcome.singular] * 2


def test_a_gradient_that_is_not_finite_ends_no_other_search() -> None:
    """sqrt(x) + y is conserved; it has no gradient at x = 0, which an iterate leaves, and no value below."""

    def image(values: Values, x: Coordinates) -> Coordinates:
        pull = 0.2 * (x[1] - jnp.sqrt(x[0]))
        return jnp.stack([(jnp.sqrt(x[0]) + pull) ** 2, x[1] - pull])

    mapping = PlainMap(image, ("x", "y"), invariants=(("sum", lambda values, x: jnp.sqrt(x[0]) + x[1]),))
    starts = np.array([[0.25, 0.1], [0.0, 0.1], [-0.2, 0.3]])
    result = newton(mapping, mapping.points(starts), {}, fix=["sum"])
    assert result.converged.tolist() == [True, True, False]
    np.testing.assert_allclose(result.points.at[:2], [[0.09, 0.3], [0.0025, 0.05]], atol=1e-9)
