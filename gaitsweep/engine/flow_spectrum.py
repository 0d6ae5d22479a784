"""The eigenvalues of the matrix of a flow, for all combinations of contacts, and its stiffness."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Inexact

from gaitsweep.contract import HybridModel, Params, State
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.solver.methods import METHODS
from gaitsweep.engine.stored_traces import counts_of_state

# Largest number of flags whose combinations are evaluated; each flag doubles the number of combinations.
MAX_FLAGS = 8
# Combinations of flags, of one row or of several, that are evaluated at a time.
_MODES_AT_A_TIME = 256
# Rates of a flow, in nominal periods, from which on it is stiff: explicit methods take as many steps a cycle.
STIFF = 2000.0


def flow_eigenvalues(model: HybridModel, params: Params, state: State) -> Inexact[np.ndarray, "modes fields"]:
    """The eigenvalues (1/s) of the flow's matrix for all combinations of a state's flags, (modes, n).

    Modes other than bools, and flags after the first `MAX_FLAGS`, are those of `state`.

    Args:
        model: a model, whose flow is linearised at the state.
        params: its parameters.
        state: a state.
    """
    matrix = jax.jit(lambda flags: _matrix(model, params, _with_flags(state, flags)))
    return np.array([np.linalg.eigvals(np.asarray(matrix(flags))) for flags in _combinations(model)])


def decay_per_period(
    model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]], starts: Mapping[str, Any]
) -> float:
    """The fastest rate at which a motion of the flow decays at the starts of some rows, in nominal periods.

    It is 0 if no motion decays; matrices and periods that are not finite are left out.

    Args:
        model: the model.
        values, starts: the parameters and the initial conditions of the rows, (n,) each.
    """
    eigenvalues, periods = _eigenvalues_of_rows(model, values, starts)
    finite = np.isfinite(periods)
    rates = -np.real(eigenvalues[finite]) * periods[finite, None, None]
    return float(np.max(rates, initial=0.0, where=np.isfinite(rates)))


def fastest_rates(
    model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]], starts: Mapping[str, Any]
) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
    """The fastest rate (1/s) of the flow at the starts of rows, and their nominal periods (s), (rows,) each.

    A rate is NaN where a derivative of the flow is infinite or NaN.

    Args:
        model: the model.
        values, starts: the parameters and the initial conditions of the rows, (n,) each.
    """
    eigenvalues, periods = _eigenvalues_of_rows(model, values, starts)
    return np.max(np.abs(eigenvalues), axis=(1, 2), initial=0.0), periods


def _combinations(model: HybridModel) -> Bool[np.ndarray, "modes flags"]:
    """All combinations of the first `MAX_FLAGS` flags of a model's state."""
    count = min(counts_of_state(model)[1], MAX_FLAGS)
    return np.array(list(itertools.product((False, True), repeat=count)), bool).reshape(2**count, count)


def _eigenvalues_of_rows(
    model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]], starts: Mapping[str, Any]
) -> tuple[Complex[np.ndarray, "rows modes fields"], Float[np.ndarray, " rows"]]:
    """The eigenvalues (1/s) of rows for all combinations of flags, NaN where unknown, and the periods (s)."""
    modes = _combinations(model)
    table = np.stack([*values.values(), *starts.values()], axis=1)
    # equal rows are computed once
    _, firsts, place_of = np.unique(table, axis=0, return_index=True, return_inverse=True)
    # the matrices of all combinations of flags are in memory, with all that they are computed from
    at_a_time = max(1, _MODES_AT_A_TIME // len(modes))
    parts = []
    for first in range(0, len(firsts), at_a_time):
        rows = firsts[first : first + at_a_time]
        columns = [
            {name: np.repeat(column[rows], len(modes)) for name, column in group.items()}
            for group in (values, starts)
        ]
        matrices, periods = _matrices_of_rows(model)(*columns, np.tile(modes, (len(rows), 1)))
        finite = np.all(np.isfinite(matrices), axis=(1, 2))
        eigenvalues = np.full(matrices.shape[:2], np.nan, complex)
        eigenvalues[finite] = np.linalg.eigvals(matrices[finite])
        parts.append((eigenvalues.reshape(len(rows), len(modes), -1), periods[:: len(modes)]))
    eigenvalues, periods = zip(*parts, strict=True)
    of_row = place_of.ravel()
    return np.concatenate(eigenvalues)[of_row], np.concatenate(periods)[of_row]


@cached_by_content(maxsize=64)
def _matrices_of_rows(model: HybridModel) -> Callable[..., Any]:
    """The function from values, starts and flags of rows to the flow's matrices and the periods (s)."""

    def of_row(values: Any, starts: Any, flags: Bool[Array, " flags"]) -> tuple[Array, Array]:
        params = model.params(values)
        state = _with_flags(model.init(params, starts), flags)
        return _matrix(model, params, state), jnp.asarray(model.period(params), float)

    return over_rows(of_row, "flow_matrices", model)


def _matrix(model: HybridModel, params: Params, state: State) -> Float[Array, "fields fields"]:
    """The derivative of the flow by the fields that it moves."""
    moving = {name: getattr(state, name) for name in jax.eval_shape(model.flow, params, state)}
    flat, unravel = jax.flatten_util.ravel_pytree(moving)

    def rates(x: Float[Array, " fields"]) -> Float[Array, " fields"]:
        flow_rates = model.flow(params, dataclasses.replace(state, **unravel(x)))
        shaped = {name: jnp.broadcast_to(flow_rates[name], jnp.shape(moving[name])) for name in moving}
        return jax.flatten_util.ravel_pytree(shaped)[0]

    return jax.jacfwd(rates)(flat)


def _with_flags(state: State, values: Bool[Array, " flags"]) -> State:
    """A state with other values of its first flags."""
    leaves, tree = jax.tree.flatten(state)
    first = 0
    for i, leaf in enumerate(leaves):
        if jnp.issubdtype(jnp.result_type(leaf), jnp.bool_):
            flat = jnp.ravel(leaf)
            new = values[first : first + flat.size]
            leaves[i] = jnp.concatenate([new, flat[new.size :]]).reshape(jnp.shape(leaf))
            first += flat.size
    return jax.tree.unflatten(tree, leaves)


def slowest_limit(model: HybridModel, params: Params, state: State, method: str) -> float:
    """The longest accurate step (s) of a method for all eigenvalues of a linear flow.

    Args:
        model: a model whose flow is linear between events.
        params: its parameters.
        state: a state.
        method: a name of `METHODS`, one that has `limits`.
    """
    eigenvalues = flow_eigenvalues(model, params, state)
    rates = np.abs(eigenvalues)
    moves = rates > 0.0
    divisors = np.where(moves, rates, 1.0)
    damping = np.where(moves, -np.real(eigenvalues) / divisors, 1.0)
    ratios, limits = zip(*METHODS[method].limits, strict=True)
    steps = np.interp(damping, ratios, limits) / divisors
    return float(np.min(np.where(moves, steps, np.inf)))
