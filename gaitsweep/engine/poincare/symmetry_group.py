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
        state: a state; combinations with the same image of a random state like it are one element.
        read: the numbers of a state that are compared; others may be a memory of the past.

    Raises:
        ArgumentError: the symmetries generate more than 47 others, so that one of them is no symmetry of
            finite order.
    """
    random = np.random.default_rng(SEED)
    drawn = [random.uniform(0.1, 0.9, np.shape(leaf)) for leaf in float_leaves(state)]
    generic = with_float_leaves(state, drawn)
    elements: dict[str, Action] = {}
    images = [np.asarray(read(generic))]
    new: dict[str, Action] = {"": lambda params, state: state}
    while new:
        later: dict[str, Action] = {}
        for before, inner in new.items():
            for name, outer in generators.items():
                combined = _after(outer, inner)
                image = np.asarray(read(combined(params, generic)))
                # a named symmetry may be the identity at these parameters alone
                if before and any(np.allclose(image, known, rtol=0.0, atol=SAME_IMAGE) for known in images):
                    continue
                images.append(image)
                later[f"{name} after {before}" if before else name] = combined
        elements |= later
        if len(elements) > MAX_ELEMENTS:
            raise ArgumentError(
                f"The symmetries {', '.join(generators)} generate more than {MAX_ELEMENTS} others: each has "
                "to be of finite order (angles are compared as numbers, so wrap them with jnp.mod)."
            )
        new = later
    return elements


def _after(outer: Action, inner: Action) -> Action:
    return lambda params, state: outer(params, inner(params, state))
