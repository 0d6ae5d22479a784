"""Random sets of the quadruped with a waist joint against MuJoCo's accelerations and located events."""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from .parameter_sets import TURN, Found, Observable, Subject, Values, between, times

from reference.dormand_prince import Fallen, LateEvent  # isort: skip
from reference.waist_quadruped_located import landings  # isort: skip

ANGLES = ("delta_13", "delta_12", "delta_34")
# Of the independent integrator, and of its second run from a start moved by 1e-9 rad.
RTOL, SECOND_RTOL = 1e-7, 1e-8


@cache
def _page() -> tuple[str, dict[str, float | str]]:
    """The MJCF and the parameters' defaults, numbers or formulas, which are data of the model."""
    from gaitsweep.papers.aoi2011.waist_quadruped.parameters import PARAMETERS, mjcf

    return mjcf(), {quantity.name: quantity.default or 0.0 for quantity in PARAMETERS}


def draw(random: np.random.Generator, n: int) -> list[Values]:
    """Factors uniform in their logarithms, the rest uniform; the limb is bent enough to stand."""

    uniform, factor = partial(between, random), partial(times, random)

    def one() -> Values:
        length = uniform(0.075, 0.1)
        return {
            "f": uniform(2.0, 3.2),
            "beta": uniform(0.65, 0.85),
            "body_mass": factor(1.0, 0.5, 2.0),
            "link_mass": factor(0.1, 0.5, 2.0),
            "link_length": length,
            "body_length": uniform(0.07, 0.14),
            "body_width": uniform(0.07, 0.14),
            "K_TL": factor(3.6e4, 0.5, 2.0),
            "D_TL": factor(175.0, 0.5, 1.5),
            "kappa_1": factor(16.3, 0.5, 2.0),
            "sigma_1": factor(0.125, 0.5, 2.0),
            "kappa_2": factor(9.75, 0.5, 2.0),
            "sigma_2": factor(0.0755, 0.5, 2.0),
            "D": uniform(0.03, 0.065),
            "H": min(uniform(0.115, 0.14), 1.75 * length),
            "delta_13": uniform(1.5, 3.5),
        }

    return [one() for _ in range(n)]


def reference(values: Values, nudge: bool, crossings: int) -> Found:
    """Dormand-Prince steps of the page's equations on MuJoCo's accelerations."""
    from gaitsweep.expression import resolve

    xml, defaults = _page()
    start = values["delta_13"] + (1e-9 if nudge else 0.0)
    parameters = {name: value for name, value in values.items() if name != "delta_13"}
    p = resolve({**defaults, **FIXED, **parameters}, {})
    try:
        result = landings(xml, p, start, crossings, rtol=SECOND_RTOL if nudge else RTOL)
    except Fallen:
        return Found("fell")
    except LateEvent:
        return Found("failed")
    last, before = result[-1], result[-2]
    one, two, three, four = (float(a) for a in last.phases)
    period = last.time - before.time
    return Found(
        "complete",
        {
            "delta_13": (one - three) % TURN,
            "delta_12": (one - two) % TURN,
            "delta_34": (three - four) % TURN,
            "t": last.time,
            "period": period,
            "speed": (last.x - before.x) / period,
        },
    )


# The stride is full and the limbs are let go of within the first cycle, so that the crossings compared walk.
FIXED = {"T_grow": 0.2, "T_hold": 0.3}


def _second(values: Values) -> float:
    """1/omega, s: the time in which a phase moves by a radian."""
    return 0.1 / (TURN * (1.0 - values["beta"]))


def subject(crossings: int) -> Subject:
    """The quadruped with its own tree as body."""
    return Subject(
        model="waist_quadruped",
        observables={
            **dict.fromkeys(ANGLES, Observable(period=TURN)),
            "t": Observable(_second),
            "period": Observable(_second),
            "speed": Observable(0.2),
        },
        draw=draw,
        reference=partial(reference, crossings=crossings),
        starts=("delta_13",),
        fixed=FIXED,
        ranges="f 2-3.2 Hz, beta .65-.85, D .03-.065 m, H .115-.14 m, link_length .075-.1 m, body_length and "
        "body_width .07-.14 m, delta_13 1.5-3.5; x .5-2 (log): body_mass, link_mass, K_TL, kappa_1, sigma_1, "
        "kappa_2, sigma_2; x .5-1.5: D_TL; T_grow .2 s, T_hold .3 s",
        about="Dormand-Prince 5(4), rtol 1e-7, located events, MuJoCo's accelerations "
        "(tests/reference/waist_quadruped_located.py)",
    )
