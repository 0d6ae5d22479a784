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
from jaxtyping import Array, Bool, Float, Inexact

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
        params, state: its parameters and a state.
    """
    matrix = jax.jit(lambda flags: _matrix(model, params, _with_flags(state, flags)))
    combinations = itertools.product((False, True), repeat=len(_flags_of(state)))
    return np.array([np.linalg.eigvals(np.asarray(matrix(jnp.array(flags, bool)))) for flags in combinations])


def decay_per_period(
    model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]], starts: Mapping[str, Any]
) -> float:
    """The fastest rate at which a motion of the flow decays at the starts of some rows, in nominal periods.

    Args:
        model: the model.
        values, starts: the parameters and the initial conditions of the rows, (n,) each.
    """
    matrices, periods = _in_all_modes(model, values, starts)
    finite = np.all(np.isfinite(matrices), axis=(1, 2)) & np.isfinite(periods)
    if not finite.any() or matrices.shape[-1] == 0:
        return 0.0
    rates = -np.linalg.eigvals(matrices[finite]).real
    return float(np.max(rates.max(axis=1) * periods[finite]))


def fastest_rates(
    model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]], starts: Mapping[str, Any]
) -> tuple[Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
    """The fastest rate (1/s) of the flow at the starts of rows, and their nominal periods (s), (rows,) each.

    A rate is NaN where a derivative of the flow is infinite or NaN. Equal rows are computed once.

    Args:
        model: the model.
        values, starts: the parameters and the initial conditions of the rows, (n,) each.
    """
    table = np.stack([*values.values(), *starts.values()], axis=1)
    _, firsts, place_of = np.unique(table, axis=0, return_index=True, return_inverse=True)
    values, starts = (
        {name: np.asarray(column)[firsts] for name, column in group.items()} for group in (values, starts)
    )
    rows = len(firsts)
    rates = np.full(rows, np.nan)
    periods = np.empty(rows)
    # the matrices of all combinations of flags are in memory, with all that they are computed from
    at_a_time = max(1, _MODES_AT_A_TIME >> min(counts_of_state(model)[1], MAX_FLAGS))
    for first in range(0, rows, at_a_time):
        part = range(first, min(first + at_a_time, rows))
        columns = [{name: column[part] for name, column in group.items()} for group in (values, starts)]
        matrices, of_modes = _in_all_modes(model, *columns)
        modes = len(of_modes) // len(part)
        for place, row in enumerate(part):
            of_row = matrices[place * modes : (place + 1) * modes]
            periods[row] = of_modes[place * modes]
            if np.all(np.isfinite(of_row)):
                rates[row] = np.max(np.abs(np.linalg.eigvals(of_row)), initial=0.0)
    return rates[place_of.ravel()], periods[place_of.ravel()]


def _in_all_modes(
    model: HybridModel, values: Mapping[str, Float[np.ndarray, " rows"]], starts: Mapping[str, Any]
) -> tuple[Float[np.ndarray, "modes fields fields"], Float[np.ndarray, " modes"]]:
    """The flow's matrices and the periods (s) of rows, each with all combinations of the flags, in turn."""
    _, flags = counts_of_state(model)
    count = min(flags, MAX_FLAGS)
    rows = len(next(iter(values.values())))  # every model has a parameter
    modes = np.array(list(itertools.product((False, True), repeat=count)), bool).reshape(2**count, count)
    matrices, periods = _matrices_of_rows(model)(
        {name: np.repeat(column, len(modes)) for name, column in values.items()},
        {name: np.repeat(column, len(modes)) for name, column in starts.items()},
        np.tile(modes, (rows, 1)),
    )
    return matrices, periods


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


def _flags_of(state: State) -> list[tuple[int, int]]:
    """The first `MAX_FLAGS` flags of a state: the leaf of each, and its place in the flat leaf."""
    flags = []
    for i, leaf in enumerate(jax.tree.leaves(state)):
        if jnp.issubdtype(jnp.result_type(leaf), jnp.bool_):
            flags += [(i, k) for k in range(int(np.prod(jnp.shape(leaf))))]
    return flags[:MAX_FLAGS]


def _with_flags(state: State, values: Bool[Array, " flags"]) -> State:
    """A state with other values of its first `MAX_FLAGS` flags."""
    leaves, tree = jax.tree.flatten(state)
    for number, (i, k) in enumerate(_flags_of(state)):
        flat = jnp.ravel(leaves[i])
        leaves[i] = jnp.concatenate([flat[:k], values[number][None], flat[k + 1 :]]).reshape(
            jnp.shape(leaves[i])
        )
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
