"""Speed of the planar quadruped beside MuJoCo, in one run: `python -m benchmarks.planar_quadruped`.

Prints steps of 1 ms a second and simulated seconds a second, of all rows together, in double precision, of

- gaitsweep's engines with the whole model: network, motors, body, contacts, and the observables and crossings
  of each cycle; the kernel with compliant feet (body tree), and XLA with MJX and MuJoCo's contacts;
- MuJoCo C on as many threads as there are cores (mujoco.rollout), and MJX (vmapped, jitted): the body alone,
  with MuJoCo's contacts, on springs in its joints that hold it on two feet, without network and observables.

`ratio` is the simulated seconds of gaitsweep's kernel over those of the row. Compilation is not included; its
time is the last column.
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
from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.sweep.sweep_spec import EngineName
from gaitsweep.papers.fukuoka2015.planar_quadruped import PlanarQuadruped
from gaitsweep.papers.fukuoka2015.planar_quadruped.mechanics import HIP, KNEE, Z, mjcf

STEP = 1e-3  # s
# Cycles of each row; a cycle takes 0.2 to 0.8 s.
CYCLES = {("kernel", "cpu"): 40, ("kernel", "gpu"): 100, ("xla", "cpu"): 1, ("xla", "gpu"): 2}
STANDING, LIFTED = 0.130, 0.057  # m, lengths of knees
TROTTING = (STANDING, LIFTED, LIFTED, STANDING)


def gaitsweep_rate(engine: EngineName, body: str, seconds: float, lanes: int | None) -> Rate:
    """The rate of sweeps over speed and seeds with one engine and one body."""

    def rows_of(n: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        return (
            {"sigma": np.random.default_rng(0).uniform(0.0, 1.0, n)},
            {"seed": np.arange(n, dtype=float), "pair": np.arange(n) % 2.0},
        )

    return sweep_rate(
        PlanarQuadruped(body),
        Numerics(dt=STEP, method="semi_implicit"),
        engine,
        CYCLES[engine, jax.default_backend()],
        rows_of,
        seconds=seconds,
        lanes=lanes,
    )


def standing() -> tuple[Any, np.ndarray]:
    """The MjModel of the body on springs in its joints, and positions (rows, nq) near LF and RH standing."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf())  # type: ignore[attr-defined]
    model.jnt_stiffness[HIP], model.jnt_stiffness[KNEE] = 8.0, 1970.0
    # as in a trot: LF and RH stand, LH and RF are lifted
    model.qpos_spring[KNEE] = TROTTING
    model.opt.timestep = STEP
    rows = 8192 if jax.default_backend() == "gpu" else 128
    random = np.random.default_rng(0)
    begin = np.zeros((rows, model.nq))
    begin[:, KNEE] = TROTTING
    begin[:, HIP] = random.uniform(-0.1, 0.1, (rows, 4))
    begin[:, Z] = 0.175 + STANDING
    return model, begin


def main() -> None:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.planar_quadruped",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    options.add_argument(
        "--lanes", type=int, help="rows at once on each device; by default, the engine's own"
    )
    chosen = options.parse_args()
    jax.config.update("jax_enable_x64", True)
    devices = local_devices(None)
    print(f"{len(devices)} x {devices[0].device_kind}; load average {os.getloadavg()[0]:.2f}; float64")
    rates = [
        ("gaitsweep, kernel, tree", gaitsweep_rate("kernel", "tree", chosen.seconds, chosen.lanes)),
        ("gaitsweep, xla, MJX with contacts", gaitsweep_rate("xla", "mjx", chosen.seconds, None)),
        (f"MuJoCo C, {os.cpu_count()} threads, body alone", mujoco_c(*standing(), chosen.seconds)),
        (f"MJX on the {devices[0].platform}, body alone", mjx_alone(*standing(), chosen.seconds)),
    ]
    base = rates[0][1].simulated
    print(f"{'':46} {'steps/s':>10} {'simulated s/s':>14} {'ratio':>8} {'ready after s':>13}")
    for name, (steps, simulated, ready) in rates:
        print(f"{name:46} {steps:10.3g} {simulated:14.4g} {base / simulated:8.3g} {ready:13.1f}")


if __name__ == "__main__":
    main()
