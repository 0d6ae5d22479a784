"""Lyapunov exponents of Lorenz's flow: `python -m benchmarks.lyapunov [--rows 10000 --cycles 200]`.

One run of many rows beside a loop in Python and NumPy over some of them, in a process for each core. Both use
the same algorithm: steps of the same Runge-Kutta pair to the same tolerances for the flow and two tangents,
crossings of the section located by the secant rule, and tangents orthonormalised there. Printed are the CPU
times a row, divided by the cores, their ratio, and both means of the largest exponent (0.9056).
"""

from __future__ import annotations

import argparse
import os
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

# one thread for each process of the loop, whose arrays are too small for more
os.environ.setdefault("OMP_NUM_THREADS", "1")

SIGMA, RHO, B = 10.0, 28.0, 8.0 / 3.0
RTOL, ATOL = 1e-8, 1e-10
TRANSIENT = 0.25  # share of the crossings that do not count
# Tsitouras 2011, Comput. Math. Appl. 62:770
A = [
    np.array([0.161]),
    np.array([-0.008480655492356989, 0.335480655492357]),
    np.array([2.8971530571054935, -6.359448489975075, 4.3622954328695815]),
    np.array([5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525]),
    np.array([5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401,
              -0.028269050394068383]),
    np.array([0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081,
              2.324710524099774]),
]  # fmt: skip
ERROR = np.array([-0.00178001105222577714, -0.0008164344596567469, 0.007880878010261995, -0.1447110071732629,
                  0.5823571654525552, -0.45808210592918697, 0.015151515151515152])  # fmt: skip


def rates(u: np.ndarray) -> np.ndarray:
    """The rates of the state, the first column of u (3, 3), and of two tangents, the others."""
    x, y, z = u[:, 0]
    jacobian = np.array([[-SIGMA, SIGMA, 0.0], [RHO - z, -1.0, -x], [y, x, -B]])
    flow = np.array([[SIGMA * (y - x)], [x * (RHO - z) - y], [x * y - B * z]])
    return np.concatenate([flow, jacobian @ u[:, 1:]], axis=1)


def step(u: np.ndarray, first: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, float]:
    """The state and tangents after a step, their rates there, and the error over the tolerance."""
    k = np.empty((7, 3, 3))
    k[0] = first
    after = u
    for stage, weights in enumerate(A, start=1):
        after = u + h * np.tensordot(weights, k[:stage], axes=1)
        k[stage] = rates(after)
    error = h * (ERROR @ k[:, :, 0])
    size = ATOL + RTOL * np.maximum(np.abs(u[:, 0]), np.abs(after[:, 0]))
    return after, k[6], float(np.max(np.abs(error) / size))


def one_row(job: tuple[float, int]) -> tuple[float, float]:
    """The largest exponent of a row from its start of x, over a number of crossings, and its CPU time (s)."""
    (x, cycles), clock = job, time.process_time()
    u = np.concatenate([np.array([[x], [1.0], [1.0]]), np.eye(3)[:, :2]], axis=1)
    first, h, t = rates(u), 1e-3, 0.0
    height = RHO - 1.0 - u[2, 0]
    crossed, begun, grown = 0, 0.0, 0.0
    while crossed < cycles:
        after, last, error = step(u, first, h)
        change = 0.9 * max(error, 1e-6) ** -0.25
        if change < 0.9:
            h *= max(change, 0.2)
            continue
        rise = RHO - 1.0 - after[2, 0]
        if not (height < 0.0 <= rise):
            u, first, height, t = after, last, rise, t + h
            h = min(h * min(change, 5.0), 0.75 / 32.0)
            continue
        low, high, middle, below, above = 0.0, h, h, height, rise
        while high - low > 1e-12:
            middle = low + (high - low) * below / (below - above)
            middle = min(max(middle, low + 1e-13), high - 1e-13)
            after, last, _ = step(u, first, middle)
            rise = RHO - 1.0 - after[2, 0]
            if abs(rise) < 1e-11:
                break
            low, below, high, above = (
                (middle, rise, high, above / 2.0) if rise < 0.0 else (low, below / 2.0, middle, rise)
            )
        u, t = after, t + middle
        # tangents at the time of the crossing, which is another one for neighbours
        flow = last[:, 0]
        tangents = u[:, 1:] - np.outer(flow, u[2, 1:]) / flow[2]
        q, r = np.linalg.qr(tangents)
        u = np.concatenate([u[:, :1], q], axis=1)
        first, height, crossed = rates(u), 0.0, crossed + 1
        if crossed == int(TRANSIENT * cycles):
            begun, grown = t, 0.0
        grown += np.log(abs(r[0, 0]))
        h = min(h, 0.75 / 32.0)
    return float(grown / (t - begun)), time.process_time() - clock


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rows", type=int, default=10_000)
    parser.add_argument("--cycles", type=int, default=200)
    parser.add_argument("--loop-rows", type=int, default=8)
    parser.add_argument("--cores", type=int, default=2)
    arguments = parser.parse_args()
    starts = np.linspace(1.0, 2.0, arguments.rows)
    cores = sorted(os.sched_getaffinity(0))[: arguments.cores]
    os.sched_setaffinity(0, cores)
    chosen = np.linspace(1.0, 2.0, arguments.loop_rows)
    with ProcessPoolExecutor(len(cores)) as pool:
        jobs = [(float(x), arguments.cycles) for x in chosen]
        exponents, seconds = zip(*pool.map(one_row, jobs), strict=True)
    loop = sum(seconds) / len(cores) / arguments.loop_rows
    # JAX begins its threads only after the loop's processes
    import gaitsweep as gs
    from gaitsweep.examples.lorenz import Lorenz

    keywords: dict[str, Any] = {
        "run": gs.Settle(max_cycles=arguments.cycles, exponents=2),
        "numerics": {"method": "tsit5", "rtol": RTOL, "atol": ATOL},
        "verify": 0,
    }
    gs.sweep(Lorenz(), x_0=starts[:64], **keywords)  # compiles the kernel
    begun = time.process_time()
    table = gs.sweep(Lorenz(), x_0=starts, **keywords).table
    one_run = (time.process_time() - begun) / len(cores) / arguments.rows
    print(f"{arguments.rows} rows of {arguments.cycles} crossings on {len(cores)} cores")
    print(f"one run   {1e3 * one_run:9.3f} ms a row, exponent {table['lyapunov_1'].mean():.4f}")
    print(f"the loop  {1e3 * loop:9.1f} ms a row, exponent {np.mean(exponents):.4f} ({len(exponents)} rows)")
    print(f"ratio     {loop / one_run:9.0f}")


if __name__ == "__main__":
    main()
