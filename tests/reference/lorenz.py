"""Write lorenz_crossings.csv: successive values of the Lorenz system by SciPy (run this file).

Two sequences of 1 000 values from one trajectory (sigma 10, rho 28, beta 8/3), after a transient of 30: `x`
where z falls through rho - 1, whose map jumps and has two branches over one x, but no fixed point; and `z` at
its maxima, whose map has a cusp and one fixed point, which is unstable (Lorenz 1963, Fig. 4).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

SIGMA, RHO, BETA = 10.0, 28.0, 8.0 / 3.0
FILE = Path(__file__).with_name("lorenz_crossings.csv")
VALUES = 1000
TRANSIENT = 30.0


def flow(_: float, state: np.ndarray) -> list[float]:
    x, y, z = state
    return [SIGMA * (y - x), x * (RHO - z) - y, x * y - BETA * z]


def section(_: float, state: np.ndarray) -> float:
    return state[2] - (RHO - 1.0)


def maximum(_: float, state: np.ndarray) -> float:
    return state[0] * state[1] - BETA * state[2]


section.direction = -1.0  # type: ignore[attr-defined]
maximum.direction = -1.0  # type: ignore[attr-defined]


def main() -> None:
    duration = TRANSIENT + 0.8 * VALUES
    start, events = [1.0, 1.0, 1.0], [section, maximum]
    run = solve_ivp(flow, (0.0, duration), start, method="DOP853", events=events, rtol=1e-10, atol=1e-10)
    x, z = (
        states[times > TRANSIENT][:VALUES, component]
        for times, states, component in zip(run.t_events, run.y_events, (0, 2), strict=True)
    )
    np.savetxt(FILE, np.stack([x, z], axis=1), "%.9f", ",", header="x,z", comments="")


if __name__ == "__main__":
    main()
