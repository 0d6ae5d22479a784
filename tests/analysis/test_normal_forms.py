"""Coefficients of normal forms where a quantity is conserved, against those of the map on its level set."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_curves import bifurcation_curve
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.critical_points import SecondParameter, equations_at
from gaitsweep.analysis.continuation.lockstep import alone
from gaitsweep.analysis.continuation.newton import ConservedConstraints
from gaitsweep.analysis.continuation.normal_forms import coefficient
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.engine.poincare.maps import Coordinates, Values

LEVEL = 0.4
ANGLE = 1.1


def terms(u: Coordinates, H: Coordinates | float) -> Coordinates:
    """Quadratic and cubic terms, which also depend on the conserved quantity."""
    x, y = u
    gain = 0.5 + H
    return gain * jnp.stack([0.7 * x**2 + 0.4 * x * y - 0.9 * x**3, 0.3 * x**2 - 0.5 * y**2 + 0.6 * x * y**2])


def reduced(kind: str) -> PlainMap:
    """A map of the plane with a bifurcation of this kind at the origin for r = 0."""

    def image(values: Values, u: Coordinates, H: Coordinates | float = LEVEL) -> Coordinates:
        if kind == "neimark_sacker":
            turn = jnp.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
            return (1.0 + values["r"]) * turn @ u + terms(u, H)
        if kind == "supercritical_pitchfork":
            return jnp.stack(
                [(1.0 + values["r"]) * u[0] + u[0] * u[1] - u[0] ** 3, 0.3 * u[1] + u[0] ** 2 * H]
            )
        first = 1.0 if kind == "fold" else -1.0
        linear = jnp.array([[first, 0.2], [0.0, 0.3]]) @ u
        shift = jnp.array([values["r"] + H - LEVEL, 0.0])
        return linear + shift + terms(u, H)

    return PlainMap(image, ("x", "y"), (("r", 0.0),))


def lifted(plane: PlainMap, unit: float = 1.0) -> PlainMap:
    """The same map in three coordinates, z = H + a curved function of x and y: H is conserved.

    The value of the conserved quantity is H times `unit`.
    """

    def curved(u: Coordinates) -> Coordinates:
        return 0.8 * u[0] ** 2 + 0.5 * u[0] * u[1] - 0.6 * u[1] ** 2 + 0.4 * u[0] ** 3

    def H(values: Values, at: Coordinates) -> Coordinates:
        return at[2] - curved(at[:2])

    def image(values: Values, at: Coordinates) -> Coordinates:
        u = plane.function(values, at[:2], H(values, at))  # type: ignore[call-arg]
        return jnp.append(u, H(values, at) + curved(u))

    return PlainMap(image, ("x", "y", "z"), plane.defaults, invariants=(("H", lambda *of: unit * H(*of)),))


def bifurcation(
    mapping: PlainMap, at: list[float], fix: list[str], **others: float
) -> tuple[ContinuationProblem, BranchPoints]:
    points = mapping.points([at])
    values = {name: np.array([value]) for name, value in others.items()}
    at_zero = mapping.linearised(points, {"r": np.zeros(1), **values})
    constraints = ConservedConstraints.of(mapping, fix, at_zero.conserved_values)
    problem = ContinuationProblem.of(mapping, "r", (-1.0, 1.0), values, constraints, points, at_zero)
    return problem, problem.first(points, np.zeros((1, len(fix))), np.zeros(1), 1.0)


@pytest.mark.parametrize("kind", ["fold", "flip", "neimark_sacker", "supercritical_pitchfork"])
def test_the_normal_form_on_a_level_set(kind: str) -> None:
    plane = reduced(kind)
    expected = coefficient(*bifurcation(plane, [0.0, 0.0], []), kind)
    found = coefficient(*bifurcation(lifted(plane), [0.0, 0.0, LEVEL], ["H"]), kind)
    assert abs(expected) > 1e-4
    # differences of Jacobians over 1e-3 of a coordinate's scale
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_the_unit_of_a_conserved_quantity_does_not_matter(unit: float) -> None:
    plane = reduced("flip")
    expected = coefficient(*bifurcation(plane, [0.0, 0.0], []), "flip")
    found = coefficient(*bifurcation(lifted(plane, unit), [0.0, 0.0, LEVEL], ["H"]), "flip")
    assert found == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_rounding_makes_no_pair_of_the_multipliers_of_two_conserved_quantities() -> None:
    """Both are 1, or a pair nearer to the unit circle than the critical one beside its bifurcation."""
    random = np.random.default_rng(3)
    for _ in range(5):
        mixing = random.normal(size=(4, 4))
        inverse = np.linalg.inv(mixing)

        def image(
            values: Values, at: Coordinates, mixing: Any = mixing, inverse: Any = inverse
        ) -> Coordinates:
            turn = jnp.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
            x = inverse @ at
            return mixing @ jnp.concatenate([(1.0 + values["r"]) * turn @ x[:2], x[2:]])

        H, K = (lambda _, at, row=row: row @ at for row in inverse[2:])
        mapping = PlainMap(image, ("a", "b", "c", "d"), (("r", 0.0),), invariants=(("H", H), ("K", K)))
        problem, at = bifurcation(mapping, [0.0] * 4, ["H", "K"])
        beside = problem.first(at.points, np.zeros((1, 2)), np.full(1, 1e-3), 1.0)
        assert equations_at(problem, beside, "neimark_sacker")[1][-1] == pytest.approx(ANGLE, abs=1e-9)


def test_flips_on_a_level_set_turn_from_super_to_subcritical() -> None:
    """The flip of -(1 + r) x + x^2 / 2 + (s - 1/4) x^3 has the coefficient s."""

    def image(values: Values, u: Coordinates, H: Coordinates | float = LEVEL) -> Coordinates:
        x, y = u
        first = -(1.0 + values["r"]) * x + 0.5 * x**2 + (values["s"] - 0.25) * x**3 + H * x**5
        return jnp.stack([first, 0.3 * y + H * x**2])

    mapping = lifted(PlainMap(image, ("x", "y"), (("r", 0.0), ("s", 0.3))))
    problem, at = bifurcation(mapping, [0.0, 0.0, LEVEL], ["H"], s=0.3)
    second = SecondParameter("s", -0.5, 0.5)
    curve = alone(bifurcation_curve(problem, at, "flip", second, ArclengthSteps()))
    assert curve is not None
    turns = [record for record in curve.records() if record["special"] == "generalized_flip"]
    assert [turn["s"] for turn in turns] == pytest.approx([0.0], abs=1e-5)
