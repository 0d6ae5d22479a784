"""Measures of the planar quadruped's equations and constants."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp

from gaitsweep.claims import default_values, measure
from gaitsweep.dynamics.matsuoka import EXTENSOR, FLEXOR, leg_feedback
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import HIP, KNEE
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import LEGS, PAIRS
from gaitsweep.papers.fukuoka2015.planar_quadruped.rhythm import ACROSS, BESIDE, Motors, swinging


@measure
def total_mass() -> float:
    """Mass of the torso and four legs (kg)."""
    names = [f"{part}_mass" for part in ("torso", "upper", "lower", "foot")]
    torso, *leg = default_values(model="planar_quadruped", names=names)
    return torso + len(LEGS) * sum(leg)


@measure
def motors() -> float:
    """Number of driven joints (1)."""
    return float(len(HIP) + len(KNEE))


@measure
def motor_targets() -> list[float]:
    """Forces of hip (N m) and knee (N) at the targets of swing and of stance, in these phases."""
    names = [field.name for field in dataclasses.fields(Motors)]
    values = dict(zip(names, default_values(model="planar_quadruped", names=names), strict=True))
    driven = Motors(**{name: jnp.asarray(value) for name, value in values.items()})
    forces = []
    for phase, active in (("sw", 1.0), ("st", -1.0)):
        swings = swinging(jnp.full((2, len(LEGS)), active))
        at = [jnp.full(len(LEGS), values[f"{name}_{phase}"]) for name in ("theta", "l")]
        forces += [float(jnp.abs(force).max()) for force in driven.forces(swings, *at)]
    return forces


@measure
def load_feedback(*, F: float, k2: float) -> list[float]:
    """Feedback of a load F (N) to extensor and flexor, over -k2 F (1)."""
    theta = jnp.zeros(len(LEGS))
    inputs = leg_feedback(theta, jnp.full(len(LEGS), F), theta0=0.0, k1=0.0, k2=k2)
    return [float(inputs[half][0]) / (-k2 * F) + 0.0 for half in (EXTENSOR, FLEXOR)]


@measure
def diagonal_links() -> float:
    """Number of links between the legs of the diagonal pairs (1)."""
    between = ACROSS + BESIDE
    return float(sum(between[LEGS.index(fore), LEGS.index(hind)] for fore, hind in PAIRS))
