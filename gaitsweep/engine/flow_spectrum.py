"""The eigenvalues of the matrix of a linear flow, for all combinations of contacts."""

from __future__ import annotations

import dataclasses
import itertools

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
        params, state: its parameters and a state.
    """
    names = list(jax.eval_shape(model.flow, params, state))
    leaves, tree = jax.tree.flatten(state)
    flags: list[tuple[int, int]] = []  # the leaf of each flag, and its place in the flat leaf
    for i, leaf in enumerate(leaves):
        if jnp.issubdtype(jnp.result_type(leaf), jnp.bool_):
            flags += [(i, k) for k in range(int(np.size(leaf)))]
    flags = flags[:MAX_FLAGS]

    @jax.jit
    def matrix(state: State) -> Float[Array, "fields fields"]:
        moving = {name: getattr(state, name) for name in names}
        flat, unravel = jax.flatten_util.ravel_pytree(moving)

        def rates(x: Float[Array, " fields"]) -> Float[Array, " fields"]:
            flow_rates = model.flow(params, dataclasses.replace(state, **unravel(x)))
            shaped = {name: jnp.broadcast_to(flow_rates[name], jnp.shape(moving[name])) for name in names}
            return jax.flatten_util.ravel_pytree(shaped)[0]

        return jax.jacfwd(rates)(flat)

    spectra = []
    for combination in itertools.product((False, True), repeat=len(flags)):
        numbers = [np.array(leaf) for leaf in leaves]
        for (i, k), flag in zip(flags, combination, strict=True):
            numbers[i].reshape(-1)[k] = flag
        spectra.append(np.linalg.eigvals(np.asarray(matrix(jax.tree.unflatten(tree, numbers)))))
    return np.array(spectra)


def slowest_limit(model: HybridModel, params: Params, state: State, method: str) -> float:
    """The longest accurate step (s) of a method for all eigenvalues of a linear flow.

    Args:
        model, params, state: as for `flow_eigenvalues`.
        method: a name of `METHODS`, one that has `limits`.
    """
    eigenvalues = flow_eigenvalues(model, params, state)
    rates = np.abs(eigenvalues)
    fast = rates > 0.0
    damping = np.where(fast, -np.real(eigenvalues) / np.where(fast, rates, 1.0), 1.0)
    ratios, limits = zip(*METHODS[method].limits, strict=True)
    allowed = np.interp(damping, ratios, limits) / np.where(fast, rates, 1.0)
    return float(np.min(np.where(fast, allowed, np.inf)))
