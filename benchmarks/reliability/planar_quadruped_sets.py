"""Random sets of the planar quadruped against a loop in MuJoCo C on the same compliant feet.

The model is defined by its steps (semi-implicit, 1 ms or what stiff feet allow), so the loop takes the same
steps, and body, feet, network and the readings of a cycle are compared. The distance of such steps from the
solution of the equations is measured separately (`parameters --finer`). With `body: mjx` contacts are
MuJoCo's own, for which there is no other solution to compare with.
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from .parameter_sets import TURN, Found, Observable, Subject, Values, between, times

from reference.planar_quadruped_varied import crossings as crossings_of  # isort: skip


@cache
def _xml() -> str:
    from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import mjcf

    return mjcf()


def draw(random: np.random.Generator, n: int) -> list[Values]:
    """Factors uniform in their logarithms, the rest uniform."""

    uniform, factor = partial(between, random), partial(times, random)

    def one() -> Values:
        torso = factor(4.0, 0.6, 1.5)
        return {
            "sigma": uniform(0.0, 1.0),
            "k2": uniform(0.0, 0.12),
            "com_x": uniform(-0.05, 0.06),
            "hip_x": uniform(0.22, 0.34),
            "torso_mass": torso,
            "torso_inertia": factor(torso * (0.67**2 + 0.1**2) / 12.0, 0.7, 1.4),
            "upper_mass": factor(0.5, 0.5, 2.0),
            "lower_mass": factor(0.2, 0.5, 2.0),
            "foot_mass": factor(0.05, 0.6, 2.0),
            "Kv_hip": factor(1.0, 0.5, 2.0),
            "Kv_knee": factor(40.0, 0.5, 2.0),
            "K_foot": factor(8e4, 0.5, 2.0),
            "D_foot": factor(250.0, 0.5, 2.0),
            "mu": uniform(0.5, 1.2),
            "v_slip": factor(0.01, 0.7, 2.0),
            "seed": float(random.integers(0, 1000)),
            "pair": float(random.integers(0, 2)),
        }

    return [one() for _ in range(n)]


def reference(values: Values, nudge: bool, crossings: int) -> Found:
    """Run MuJoCo C's masses and kinematics with forces of the feet and Euler steps of the network in NumPy.

    The steps are `values["dt"]` (s). With `nudge` the torso starts 1e-9 m higher.
    """
    recorded = crossings_of(_xml(), values, crossings, dt=values["dt"], nudge=1e-9 if nudge else 0.0)
    if recorded is None:
        return Found("fell")
    last = recorded[-1]
    return Found(
        "complete",
        {"delta_1": last.delta_1, "delta_2": last.delta_2, "period": last.period, "speed": last.speed},
    )


def subject(crossings: int) -> Subject:
    """The quadruped on compliant feet."""
    return Subject(
        model="planar_quadruped",
        observables={
            "delta_1": Observable(1.0 / TURN, 1.0),
            "delta_2": Observable(1.0 / TURN, 1.0),
            "period": Observable(0.5 / TURN),  # of a cycle of half a second
            "speed": Observable(1.0),
        },
        draw=draw,
        reference=partial(reference, crossings=crossings),
        starts=("seed", "pair"),
        same_steps=True,
        ranges="sigma 0-1, k2 0-0.12, com_x -0.05-0.06 m, hip_x 0.22-0.34 m, mu 0.5-1.2; "
        "torso_mass x 0.6-1.5, torso_inertia x 0.7-1.4, v_slip x 0.7-2, foot_mass x 0.6-2; x 0.5-2: "
        "upper_mass, lower_mass, Kv_hip, Kv_knee, K_foot, D_foot; seeds 0-999, both pairs",
        about="MuJoCo C's body, feet as springs and dampers, the model's own steps "
        "(tests/reference/planar_quadruped_varied.py)",
    )
