"""The eigenvalues of the matrix of a linear flow, for all combinations of contacts."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Inexact

from gaitsweep.contract import HybridModel, Params, State
from gaitsweep.engine.solver import METHODS

# Largest number of flags whose combinations are evaluated; each flag doubles the number of combinations.
MAX_FLAGS = 8


def flow_eigenvalues(model: HybridModel, params: Params, state: State) -> Inexact[np.ndarray, "modes fields"]:
    """The eigenvalues (1/s) of the flow's matrix for all combinations of a state's flags, (modes, n).

    Modes other than bools, and flags after the first `MAX_FLAGS`, are those of `state`.

    Args:
        model: a model whose flow is linear between events.
        params: its parameters.
        state: a state.
    """
    names = list(jax.eval_shape(model.flow, params, state))

    @jax.jit
    def matrix(state: State) -> Float[Array, "fields fields"]:
        moving = {name: getattr(state, name) for name in names}
        flat, unravel = jax.flatten_util.ravel_pytree(moving)

        def rates(x: Float[Array, " fields"]) -> Float[Array, " fields"]:
            flow_rates = model.flow(params, dataclasses.replace(state, **unravel(x)))
            shaped = {name: jnp.broadcast_to(flow_rates[name], jnp.shape(moving[name])) for name in names}
            return jax.flatten_util.ravel_pytree(shaped)[0]

        return jax.jacfwd(rates)(flat)

    return np.array([np.linalg.eigvals(np.asarray(matrix(modes))) for modes in _all_modes(state)])


def _all_modes(state: State) -> Iterator[State]:
    """The state with all combinations of its first `MAX_FLAGS` flags."""
    leaves, tree = jax.tree.flatten(state)
    flags: list[tuple[int, int]] = []  # the leaf of each flag, and its place in the flat leaf
    for number, leaf in enumerate(leaves):
        if jnp.issubdtype(jnp.result_type(leaf), jnp.bool_):
            flags += [(number, place) for place in range(int(np.size(leaf)))]
    flags = flags[:MAX_FLAGS]
    for combination in itertools.product((False, True), repeat=len(flags)):
        arrays = [np.array(leaf) for leaf in leaves]
        for (number, place), flag in zip(flags, combination, strict=True):
            arrays[number].reshape(-1)[place] = flag
        yield jax.tree.unflatten(tree, arrays)


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
