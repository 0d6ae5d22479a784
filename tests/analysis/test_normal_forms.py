"""Coefficients of normal forms where a quantity is conserved, against those of the map on its level set."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
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


def lifted(plane: PlainMap) -> PlainMap:
    """The same map in three coordinates, z = H + a curved function of x and y: H is conserved."""

    def curved(u: Coordinates) -> Coordinates:
        return 0.8 * u[0] ** 2 + 0.5 * u[0] * u[1] - 0.6 * u[1] ** 2 + 0.4 * u[0] ** 3

    def H(values: Values, at: Coordinates) -> Coordinates:
        return at[2] - curved(at[:2])

    def image(values: Values, at: Coordinates) -> Coordinates:
        u = plane.function(values, at[:2], H(values, at))  # type: ignore[call-arg]
        return jnp.append(u, H(values, at) + curved(u))

    return PlainMap(image, ("x", "y", "z"), (("r", 0.0),), invariants=(("H", H),))


def bifurcation(
    mapping: PlainMap, at: list[float], fix: list[str]
) -> tuple[ContinuationProblem, BranchPoints]:
    points = mapping.points([at])
    values = {"r": np.zeros(1)}
    constraints = ConservedConstraints.of(mapping, fix, mapping.linearised(points, values).conserved_values)
    problem = ContinuationProblem.of(mapping, "r", (-1.0, 1.0), {}, constraints, points.at)
    return problem, problem.first(points, np.zeros((1, len(fix))), np.zeros(1), 1.0)


@pytest.mark.parametrize("kind", ["fold", "flip", "neimark_sacker", "supercritical_pitchfork"])
def test_the_normal_form_on_a_level_set(kind: str) -> None:
    plane = reduced(kind)
    expected = coefficient(*bifurcation(plane, [0.0, 0.0], []), kind)
    found = coefficient(*bifurcation(lifted(plane), [0.0, 0.0, LEVEL], ["H"]), kind)
    assert abs(expected) > 1e-4
    # differences of Jacobians over 1e-3 of a coordinate's scale
    assert found == pytest.approx(expected, rel=1e-4)
