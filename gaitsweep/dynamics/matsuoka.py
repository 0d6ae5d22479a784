"""Matsuoka oscillators: half-centres with fatigue and mutual inhibition, an extensor and a flexor a leg.

    Tr u' = -u + gamma y(opposite) + sum of weight x y(linked) - b f + s + feedback,    y = max(0, u)
    Ta f' = -f + y

Arrays are (2, n): the n legs' extensors in row EXTENSOR, their flexors in row FLEXOR. Weights are added, so
inhibition has a negative weight. The equations are homogeneous: u, f and all inputs may be multiplied by one
constant, and so may time, Tr and Ta.

Source: Matsuoka 1985, Biol. Cybern. 52:367, and 1987, Biol. Cybern. 56:345; the symbols are those of Fukuoka,
Habu and Fukui 2015, Sci. Rep. 5:8169, where f is a flexor as an index and the fatigue as a variable.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterable, Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

__all__ = ["EXTENSOR", "FLEXOR", "Coupling", "leg_feedback", "links", "rates"]

Scalar: TypeAlias = jax.Array | float

EXTENSOR, FLEXOR = 0, 1


class Coupling(NamedTuple):
    """A coupling between half-centres: `weight` times the outputs along `links`.

    `links` are (n, n), to each leg from each leg, extensors to extensors and flexors to flexors. They are
    structure, a NumPy constant: zeros are not computed.
    """

    weight: Scalar
    links: Float[np.ndarray, "legs legs"]


def links(n: int, pairs: Iterable[tuple[int, int]]) -> Float[np.ndarray, "legs legs"]:
    """The links (n, n) that are 1 between the legs of each pair, in both directions.

    Args:
        n: number of legs.
        pairs: pairs of leg numbers, counted from 0.

    Raises:
        ValueError: a pair has one leg twice, or a leg that does not exist.
    """
    weights = np.zeros((n, n))
    for i, j in pairs:
        if i == j or not (0 <= i < n and 0 <= j < n):
            raise ValueError(f"({i}, {j}) is not a pair of {n} legs: give two of 0 to {n - 1}")
        weights[i, j] = weights[j, i] = 1.0
    return weights


def rates(
    u: Float[Array, "2 legs"],
    f: Float[Array, "2 legs"],
    *,
    s: Scalar,
    Tr: Scalar,
    Ta: Scalar,
    b: Scalar,
    gamma: Scalar,
    couplings: Sequence[Coupling] = (),
    feedback: Scalar = 0.0,
) -> tuple[Float[Array, "2 legs"], Float[Array, "2 legs"]]:
    """Time derivatives (2, n) of the potentials u and of the fatigue f, per second.

    Args:
        u, f: potentials and fatigue, (2, n).
        s: tonic drive, a scalar or (2, n).
        Tr, Ta: time constants of the rise and of the adaptation, s.
        b: gain of the inhibition by fatigue.
        gamma: weight between the two half-centres of a leg.
        couplings: the weights between legs.
        feedback: sensory input of each half-centre, a scalar or (2, n).

    Raises:
        TypeError: links are not a NumPy array.
        ValueError: the shape of the links does not fit the number of legs.

    Source: Matsuoka 1985 and 1987; Fukuoka et al. 2015, Methods and Fig. 7(a).
    """
    y = jnp.maximum(u, 0.0)
    received = gamma * y[::-1]
    for weight, between in couplings:
        received = received + weight * _along(between, y)
    return (-u + received - b * f + s + feedback) / Tr, (-f + y) / Ta


def leg_feedback(
    theta: Float[Array, " legs"], F: Float[Array, " legs"], *, theta0: Scalar, k1: Scalar, k2: Scalar
) -> Float[Array, "2 legs"]:
    """Feedback (2, n): each leg's hip angle to both its half-centres, its load to its flexor.

    Args:
        theta: hip angles relative to the torso, (n,) rad, leg forward positive.
        F: loads on the feet, (n,) N, not negative.
        theta0: hip angle of zero feedback, rad.
        k1, k2: gains, 1/rad and 1/N.

    Source: Fukuoka et al. 2015, eq. (1) for the load, Methods for the hip.
    """
    hip = k1 * (theta - theta0)
    return jnp.stack([hip, -hip - k2 * F])


def _along(between: np.ndarray, y: Float[Array, "2 legs"]) -> Float[Array, "2 legs"]:
    """The outputs (2, n) summed along the links, written out, without linear algebra routines."""
    if not isinstance(between, np.ndarray):
        raise TypeError(
            "links are structure: give a NumPy array, and varying numbers as the coupling's weight"
        )
    n = y.shape[1]
    if between.shape != (n, n):
        raise ValueError(f"links between {n} legs are ({n}, {n}), not {between.shape}")
    columns = []
    for row in between:
        terms = [y[:, j] if row[j] == 1.0 else float(row[j]) * y[:, j] for j in np.flatnonzero(row)]
        columns.append(functools.reduce(operator.add, terms) if terms else jnp.zeros_like(y[:, 0]))
    return jnp.stack(columns, axis=1)
