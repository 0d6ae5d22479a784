"""The group of a model's symmetries: those that it names, and those that follow when they are combined."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from jaxtyping import Array, Float

from gaitsweep.contract import Params, State
from gaitsweep.engine.leaves import float_leaves, with_float_leaves
from gaitsweep.errors import ArgumentError

Action: TypeAlias = "Callable[[Params, State], State]"
# Largest number of elements besides the identity.
MAX_ELEMENTS = 47
# Seed of the state whose images tell the elements apart.
SEED = 20
# Images of one state are the same if they differ by less.
SAME_IMAGE = 1e-9


def group_of(
    generators: Mapping[str, Action],
    params: Params,
    state: State,
    read: Callable[[State], Float[Array, " coordinates"]],
) -> dict[str, Action]:
    """The elements of the group besides the identity, by name: "a", "b", "a after b", ...

    Args:
        generators: the symmetries that a model names.
        params: parameters of the model.
        state: a state; combinations with the same image of a random state of its shape are one element.
        read: returns the numbers of a state that are compared; others may be a memory of the past.

    Raises:
        ArgumentError: the symmetries generate more than `MAX_ELEMENTS`, so that one of them is no symmetry of
            finite order.
    """
    random = np.random.default_rng(SEED)
    numbers = [random.uniform(0.1, 0.9, np.shape(leaf)) for leaf in float_leaves(state)]
    generic = with_float_leaves(state, numbers)
    # named symmetries are elements even if they are the identity at these parameters alone
    elements = dict(generators)
    images = [np.asarray(read(generic))]
    images += [np.asarray(read(action(params, generic))) for action in generators.values()]
    latest = dict(generators)
    while latest:
        combinations: dict[str, Action] = {}
        for inner_name, inner in latest.items():
            for outer_name, outer in generators.items():
                combined = _after(outer, inner)
                image = np.asarray(read(combined(params, generic)))
                if not any(np.allclose(image, other, rtol=0.0, atol=SAME_IMAGE) for other in images):
                    images.append(image)
                    combinations[f"{outer_name} after {inner_name}"] = combined
        elements |= combinations
        if len(elements) > MAX_ELEMENTS:
            raise ArgumentError(
                f"The symmetries {', '.join(generators)} generate more than {MAX_ELEMENTS} others: each has "
                "to be of finite order (angles are compared as numbers, so wrap them with jnp.mod)."
            )
        latest = combinations
    return elements


def _after(outer: Action, inner: Action) -> Action:
    """The symmetry `outer` applied after `inner`."""
    return lambda params, state: outer(params, inner(params, state))
