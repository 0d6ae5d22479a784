"""The phase response of a gait to small pushes, exactly, from the linearised return map.

A push changes where and when the section is crossed next. The crossings after that return to the gait, and
the times by which they come late add up. With M the derivative of the return map at the gait, and g that of
the return time, a displacement d of a crossing delays all later ones by g (1 + M + M^2 + ...) d = w d in the
end, so that w (1 - M) = g: the adjoint solution on the section.

Sources: Ermentrout and Terman 2010, Mathematical Foundations of Neuroscience, ch. 8, of the adjoint;
Shirasaka, Kurebayashi and Nakao 2017, Chaos 27:023119, of systems with jumps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import HybridModel, State
from gaitsweep.engine.advance import advance
from gaitsweep.engine.carry import Halt, Number, start
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.numerics import step_of
from gaitsweep.engine.poincare.maps import Coordinates, Points, Values
from gaitsweep.engine.poincare.poincare_return import ReturnStatus
from gaitsweep.engine.poincare.return_map import BatchedReturnMap
from gaitsweep.engine.pushed_model import Place
from gaitsweep.errors import ArgumentError

# The largest distance of a multiplier from 1 that counts as that of a family of gaits, and the largest change
# of the period along the family, as a share of the period for a unit vector of coordinates.
NEUTRAL = 1e-6
# The largest distance from a crossing of a gait to its image, a share of each coordinate's scale.
NOT_REPEATED = 1e-4


def phase_response(
    mapping: BatchedReturnMap,
    gait: Points,
    values: Values,
    period: int,
    variables: Sequence[Place],
    phases: Float[np.ndarray, " phases"],
) -> Float[np.ndarray, "phases variables"]:
    """The phase response of a stable gait: the phase that it gains for good by a push, per unit of the push.

    Args:
        mapping: the return map of one crossing.
        gait: one point, a crossing of the gait.
        values: the parameters of that point.
        period: crossings after which the gait repeats.
        variables: those that are pushed, as `flow_places` gives them.
        phases: shares of the gait's period after that crossing, from 0 to below 1.

    Returns:
        The response (phases, variables), as a share of the gait's period per unit of each variable.

    Raises:
        ArgumentError: the gait does not return to the section, does not repeat, is unstable, or belongs to a
            family along which its period changes.
    """
    complete = {name: column[0] for name, column in mapping.complete(values, 1).items()}
    at, modes = jnp.asarray(gait.at[0]), jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), gait.modes)
    one_return, crossings = _one_return(mapping), []
    times, gradients, jacobians = [], [], []
    for crossing in range(period):
        (t, image), (gradient, jacobian), (state, status) = one_return(complete, at, modes)
        _require_crossing(status, crossing / period)
        crossings.append((at, modes))
        times.append(float(t))
        gradients.append(np.asarray(gradient))
        jacobians.append(np.asarray(jacobian))
        at, modes = image, state
    if (miss := float(mapping.distance(gait.at[0], np.asarray(at)))) > NOT_REPEATED:
        after = "a crossing" if period == 1 else f"{period} crossings"
        raise ArgumentError(
            f"The point is of no gait: after {after} a coordinate differs by {miss:.2g} of its size. Take a "
            "point of `fixed_points`, of a return map with the gait's period."
        )
    total = float(np.sum(times))
    begins = np.concatenate([[0.0], np.cumsum(times)])  # the time of each crossing
    delays = _delays(gradients, jacobians, total)
    pushed = _pushed(mapping, tuple(variables))
    response = np.zeros((len(phases), len(variables)))
    for k, phase in enumerate(phases):
        crossing = int(np.clip(np.searchsorted(begins, phase * total, side="right") - 1, 0, period - 1))
        late, moved, status = pushed(complete, *crossings[crossing], phase * total - begins[crossing])
        _require_crossing(status, phase)
        response[k] = -(np.asarray(late) + delays[crossing] @ np.asarray(moved)) / total
    return response


def _require_crossing(status: Any, phase: float) -> None:
    """Refuse a trajectory that does not cross the section after a phase of the gait."""
    if (code := ReturnStatus(int(status))) != ReturnStatus.crossed:
        raise ArgumentError(f"The gait has no crossing after phase {phase:g}: {code.name}.")


def _delays(
    gradients: Sequence[Float[np.ndarray, " coordinates"]],
    jacobians: Sequence[Float[np.ndarray, "coordinates coordinates"]],
    total: float,
) -> list[Float[np.ndarray, " coordinates"]]:
    """The final delay (s) per displacement of the crossing that follows each of a gait's crossings.

    Args:
        gradients, jacobians: the derivatives, at each crossing, of the time (s) to the next one and of its
            coordinates.
        total: the gait's period, s.
    """
    matrix, gradient = np.eye(len(gradients[0])), np.zeros(len(gradients[0]))
    for of_time, of_coordinates in zip(gradients, jacobians, strict=True):
        gradient = gradient + of_time @ matrix
        matrix = of_coordinates @ matrix
    multipliers, right = np.linalg.eig(matrix)
    neutral = np.abs(multipliers - 1.0) < NEUTRAL
    if unstable := int(np.sum((np.abs(multipliers) >= 1.0) & ~neutral)):
        largest = np.abs(multipliers).max()
        raise ArgumentError(
            f"The gait has {unstable} multipliers on or outside the unit circle (up to {largest:.6g}): "
            "its phase response does not exist."
        )
    projector = np.zeros_like(matrix)
    if neutral.any():
        # gaits in families: a push may move the row to a neighbour, which has to have the same period
        along = right[:, neutral]
        if np.abs(gradient @ along).max() > NEUTRAL * total:
            raise ArgumentError(
                "The gait belongs to a family along which its period changes: no phase shift stays."
            )
        left = np.linalg.inv(right)[neutral]
        projector = (along @ left).real
    delay = np.linalg.solve((np.eye(len(matrix)) - matrix + projector).T, gradient)
    # that of the first crossing follows the last one
    delays = [delay]
    for of_time, of_coordinates in zip(reversed(gradients[1:]), reversed(jacobians[1:]), strict=True):
        delay = of_time + of_coordinates.T @ delay
        delays.append(delay)
    return delays[::-1]


@cached_by_content(maxsize=16)
def _one_return(mapping: BatchedReturnMap) -> Callable[..., Any]:
    """The function `(values, at, modes) -> ((t, image), derivatives, (state, status))` of one return."""

    def one(values: Any, at: Coordinates, modes: State) -> Any:
        params = mapping.params(values)

        def returned(at: Coordinates) -> Any:
            t, state, status = mapping.state(params, mapping.chart.from_coordinates(params, at, modes))
            image = mapping.chart.to_coordinates(params, state)
            return (t, image), ((t, image), (state, status))

        derivatives, (image, end) = jax.jacfwd(returned, has_aux=True)(at)
        return image, derivatives, end

    return jax.jit(one)


@cached_by_content(maxsize=16)
def _pushed(mapping: BatchedReturnMap, variables: tuple[Place, ...]) -> Callable[..., Any]:
    """The function `(values, at, modes, t) -> (late, moved, status)` of a push `t` s after a crossing.

    `late` (variables,) is the derivative of the time of the next crossing, `moved` (coordinates, variables)
    that of its coordinates.
    """
    model, numerics = mapping.model, mapping.integration
    assert isinstance(model, HybridModel)
    attempt = advance(model, numerics)

    def one(values: Any, at: Coordinates, modes: State, t: Number) -> Any:
        params = mapping.params(values)
        state_at_crossing = mapping.chart.from_coordinates(params, at, modes)
        dt = numerics.factor * step_of(model, numerics, params)
        carry = start(model, params, state_at_crossing, dt=dt, stop=t, step_factor=numerics.factor)
        carry = jax.lax.while_loop(
            lambda carry: carry.halt == Halt.GOING, lambda carry: attempt(params, carry), carry
        )

        def crossing(amounts: Float[Array, " variables"]) -> Any:
            state = carry.state
            for (name, index), amount in zip(variables, amounts, strict=True):
                pushed = jnp.asarray(getattr(state, name)).at[index].add(amount)
                state = dataclasses.replace(state, **{name: pushed})
            after, state, status = mapping.state(params, model.displaced(params, state))
            return (after, mapping.chart.to_coordinates(params, state)), status

        (late, moved), status = jax.jacfwd(crossing, has_aux=True)(jnp.zeros(len(variables)))
        return late, moved, status

    return jax.jit(one)
