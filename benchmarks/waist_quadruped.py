"""Speed of the quadruped with a waist beside MuJoCo, in one run: `python -m benchmarks.waist_quadruped`.

Prints steps (of all rows together) and simulated seconds a second, in double precision where nothing else is
said, for
 (a) gaitsweep's engines: the whole model, that is mechanics, feet on the ground, PD control, oscillators,
     landings and the crossings kept, in steps of 0.2 ms, in double and in mixed precision, and with located
     events,
 (b) the same model with MJX as its body, on XLA,
 (c) MuJoCo C on as many threads as there are cores (mujoco.rollout) and MJX (vmapped, jitted), this one in
     single precision too: the body alone in their own Euler steps of 0.2 ms, with no feet, no control and no
     oscillators, which is less work.

`ratio` is (a)'s kernel of the same precision (mixed where a row is in single) in steps of 0.2 ms over this
row, in simulated seconds. Compilation stands apart.
"""

from __future__ import annotations

import argparse
import os
from typing import Any

import jax
import numpy as np

from benchmarks.bodies_alone import mjx_alone, mujoco_c
from benchmarks.sweep_rate import Rate, sweep_rate
from gaitsweep.engine.devices import local_devices
from gaitsweep.engine.numerics import Numerics, Precision
from gaitsweep.engine.sweep.sweep_spec import EngineName
from gaitsweep.papers.aoi2011.waist_quadruped import WaistQuadruped
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import mjcf

STEP = 2e-4  # s
LOCATED = 3e-4  # s, the longest step where events are located
# Cycles of 0.4 s for each row; a row is opened on the CPU, so that a GPU's rows run as long as in a sweep.
CYCLES = {("kernel", "cpu"): 20, ("kernel", "gpu"): 100, ("xla", "cpu"): 2, ("xla", "gpu"): 2}


def ours(
    engine: EngineName,
    method: str,
    dt: float,
    seconds: float,
    lanes: int | None,
    body: str = "tree",
    precision: Precision = "float64",
) -> Rate:
    """Whole sweeps of the model."""

    def rows_of(n: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        random = np.random.default_rng(0)
        return {"f": random.uniform(2.0, 3.2, n)}, {"delta_13": random.uniform(2.0, 3.2, n)}

    return sweep_rate(
        WaistQuadruped(body),
        Numerics(dt=dt, method=method, precision=precision),
        engine,
        CYCLES[engine, jax.default_backend()],
        rows_of,
        seconds=seconds,
        lanes=lanes,
    )


def alone() -> tuple[Any, np.ndarray]:
    """The body alone with steps of 0.2 ms, and random positions of its joints to start from."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf())  # type: ignore[attr-defined]
    model.opt.timestep = STEP
    rows = 32768 if jax.default_backend() == "gpu" else 256
    bent = np.random.default_rng(0).uniform(-0.3, 0.3, (rows, model.nq)) * (np.arange(model.nq) > 6)
    return model, model.qpos0 + bent


def main() -> None:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.waist_quadruped",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    options.add_argument(
        "--lanes", type=int, help="rows at once on each device; by default, the engine's own"
    )
    options.add_argument("--quick", action="store_true", help="leave out the tree on XLA and located events")
    chosen = options.parse_args()
    jax.config.update("jax_enable_x64", True)
    devices = local_devices(None)
    print(f"{len(devices)} x {devices[0].device_kind}; load average {os.getloadavg()[0]:.2f}")
    names = {
        "semi_implicit": f"steps of {1e3 * STEP:g} ms",
        "rk4": f"rk4 {1e3 * LOCATED:g} ms, located events",
    }
    results: list[tuple[str, str, Rate]] = []
    cases: list[tuple[EngineName, str, str, Precision]] = [
        ("kernel", "semi_implicit", "tree", "float64"),
        ("kernel", "semi_implicit", "tree", "mixed"),
        ("xla", "semi_implicit", "mjx", "float64"),
    ]
    if not chosen.quick:
        cases.append(("kernel", "rk4", "tree", "float64"))
        cases.append(("xla", "semi_implicit", "tree", "float64"))
    for engine, method, body, precision in cases:
        dt = STEP if method == "semi_implicit" else LOCATED
        lanes = chosen.lanes if engine == "kernel" else None
        rates = ours(engine, method, dt, chosen.seconds, lanes, body, precision)
        in_mixed = ", mixed precision" if precision == "mixed" else ""
        results.append((f"gaitsweep, {engine}, {body}, {names[method]}{in_mixed}", precision, rates))
    threads, platform = os.cpu_count(), devices[0].platform
    results.append(
        (f"MuJoCo C, {threads} threads, body alone", "float64", mujoco_c(*alone(), chosen.seconds))
    )
    results.append((f"MJX on the {platform}, body alone", "float64", mjx_alone(*alone(), chosen.seconds)))
    single = mjx_alone(*alone(), chosen.seconds, "float32")
    results.append((f"MJX on the {platform}, body alone, single", "mixed", single))
    base = {"float64": results[0][2].simulated, "mixed": results[1][2].simulated}
    print(f"{'':62} {'steps/s':>10} {'simulated s/s':>14} {'ratio':>8} {'ready in, s':>12}")
    for name, precision, (steps, simulated, ready) in results:
        print(f"{name:62} {steps:10.3g} {simulated:14.4g} {base[precision] / simulated:8.3g} {ready:12.1f}")


if __name__ == "__main__":
    main()
