"""Random sets of the multi-legged chain against its exact propagation between events."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from .parameter_sets import TURN, Found, Observable, Subject, Values

from reference import multilegged_exact  # isort: skip
from reference.multilegged_page import Parameters  # isort: skip

PSI = ("psi_1", "psi_2", "psi_3")


def draw(random: np.random.Generator, n: int) -> list[Values]:
    """m_B and beta uniform, kappa and K uniform in their logarithms, starts uniform."""
    columns = {
        "m_B": random.uniform(0.55, 0.99, n),
        "kappa": np.exp(random.uniform(np.log(30.0), np.log(300.0), n)),
        "K": np.exp(random.uniform(np.log(3e4), np.log(1e6), n)),
        "beta": random.uniform(0.6, 0.9, n),
        **{name: random.uniform(0.0, TURN, n) for name in PSI},
    }
    return [{name: float(column[i]) for name, column in columns.items()} for i in range(n)]


def reference(values: Values, nudge: bool, crossings: int) -> Found:
    """Matrix exponentials between located events; moved by 1e-9 rad at the start where `nudge` says so."""
    constants: dict[str, Any] = {name: value for name, value in values.items() if name not in PSI}
    p = Parameters(**constants)
    psi = np.array([values[name] for name in PSI]) + (1e-9 if nudge else 0.0)
    try:
        last = multilegged_exact.run(p, psi, crossings).crossings[crossings]
    except ArithmeticError:
        return Found("failed")
    finally:
        multilegged_exact.propagators.cache_clear()
    observed = {name: float(angle) for name, angle in zip(PSI, last.psi, strict=True)}
    return Found("complete", {**observed, "landed": float(last.landed), "t": last.t})


def subject(crossings: int) -> Subject:
    """The chain of four legs."""
    angle = Observable(period=TURN)
    return Subject(
        model="multilegged",
        observables={**dict.fromkeys(PSI, angle), "landed": Observable(), "t": Observable(1.0 / 0.4)},
        draw=draw,
        reference=partial(reference, crossings=crossings),
        starts=PSI,
        ranges="m_B .55-.99 kg, kappa 30-300 N/m (log), K 3e4-1e6 N/m (log), beta .6-.9, starts 0-2 pi",
        about="matrix exponentials between events located to rounding (tests/reference/multilegged_exact.py)",
    )
