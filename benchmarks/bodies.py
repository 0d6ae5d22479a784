"""Speed of a body of an MJCF beside MuJoCo, in one run: `python -m benchmarks.bodies`.

The body is like Gymnasium's half-cheetah: a trunk in a plane and two legs of three joints with springs,
dampers and motors, which an oscillator drives; eight capsules may touch the floor. Prints steps a second and
simulated seconds a second, of all rows together, in double precision and at the same step, of

- gaitsweep's kernel: `BodyModel` by Runge and Kutta's steps of order 4, contacts located, and the observables
  and crossings of each cycle;
- MuJoCo C on as many threads as there are cores (mujoco.rollout), driven by the same controls, by its
  semi-implicit Euler steps (and by its own Runge and Kutta's), with its own contacts;
- with `--mjx`, MJX (vmapped, jitted) without controls.

Then, of a quadruped with a free trunk and eight hinges that trots in open loop, rows over the mass of its
thighs and the length of its shins:

- gaitsweep's kernel, as above, of which these are parameters;
- MuJoCo C, each row compiled from the edited MJCF, by joblib on all cores (or by a pool of processes).

`ratio` is the simulated seconds of gaitsweep's kernel over those of the row. Compilation is not included; its
time is the last column. Last, the seconds of the clock and of CPU time from the start of a Python to the end
of its first sweep of the body, without and with cached kernels.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import gaitsweep as gs
from benchmarks.bodies_alone import changed_bodies, cores, mjx_alone, mujoco_c
from benchmarks.start_up import run
from benchmarks.sweep_rate import Rate, Values, sweep_rate
from gaitsweep.engine.devices import local_devices
from gaitsweep.engine.numerics import Numerics

STEP = 2e-3  # s
OMEGA = 12.0  # rad/s
CYCLES = {"cpu": 20, "gpu": 40}
CHEETAH = """
<mujoco model="cheetah">
  <option timestep="0.002"/>
  <default>
    <joint axis="0 1 0" limited="true" armature=".1"/>
    <geom contype="1" conaffinity="0" condim="3" friction=".6" size=".046"/>
    <motor ctrllimited="true" ctrlrange="-1 1"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="40 40 .1" conaffinity="1"/>
    <body name="torso" pos="0 0 .7">
      <joint name="x" type="slide" axis="1 0 0" limited="false" armature="0"/>
      <joint name="z" type="slide" axis="0 0 1" limited="false" armature="0"/>
      <joint name="pitch" type="hinge" limited="false" armature="0"/>
      <geom name="torso" type="capsule" fromto="-.5 0 0 .5 0 0" mass="6.4"/>
      <geom name="head" type="capsule" fromto=".5 0 0 .7 0 .2" mass="1.6"/>
      <body name="bthigh" pos="-.5 0 0">
        <joint name="bthigh" range="-30 60" stiffness="240" damping="6"/>
        <geom name="bthigh" type="capsule" fromto="0 0 0 .16 0 -.25" mass="1.5"/>
        <body name="bshin" pos=".16 0 -.25">
          <joint name="bshin" range="-45 45" stiffness="180" damping="4.5"/>
          <geom name="bshin" type="capsule" fromto="0 0 0 -.28 0 -.14" mass="1.6"/>
          <body name="bfoot" pos="-.28 0 -.14">
            <joint name="bfoot" range="-23 45" stiffness="120" damping="3"/>
            <geom name="bfoot" type="capsule" fromto="-.03 0 0 .15 0 -.18" mass="1.1"/>
          </body>
        </body>
      </body>
      <body name="fthigh" pos=".5 0 0">
        <joint name="fthigh" range="-57 40" stiffness="180" damping="4.5"/>
        <geom name="fthigh" type="capsule" fromto="0 0 0 -.14 0 -.24" mass="1.4"/>
        <body name="fshin" pos="-.14 0 -.24">
          <joint name="fshin" range="-70 50" stiffness="120" damping="3"/>
          <geom name="fshin" type="capsule" fromto="0 0 0 .13 0 -.18" mass="1.2"/>
          <body name="ffoot" pos=".13 0 -.18">
            <joint name="ffoot" range="-28 28" stiffness="60" damping="1.5"/>
            <geom name="ffoot" type="capsule" fromto="0 0 0 .07 0 -.13" mass=".9"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="bthigh" gear="120" name="bthigh"/>
    <motor joint="bshin" gear="90" name="bshin"/>
    <motor joint="bfoot" gear="60" name="bfoot"/>
    <motor joint="fthigh" gear="120" name="fthigh"/>
    <motor joint="fshin" gear="60" name="fshin"/>
    <motor joint="ffoot" gear="30" name="ffoot"/>
  </actuator>
</mujoco>"""
# Phases of the motors' controls behind the oscillator, rad.
LAGS = np.array([0.0, 0.8, 1.6, 2.6, 3.4, 4.2])


class Cheetah(gs.BodyModel):
    """The body, driven by one oscillator; the section is the phase 0."""

    body_file = CHEETAH
    omega = gs.parameter("rad/s", "frequency of the oscillator", OMEGA, low=0.0, open_ends=True)
    drive = gs.parameter("1", "amplitude of the controls", 0.5)
    phi = gs.variable("rad", "phase of the oscillator", 0.0, circular=True, observed=False)

    def control(self, p: Any, s: Any) -> Any:
        # sin(phi - lag) of all motors from one sine and one cosine
        return p.drive * (jnp.sin(s.phi) * np.cos(LAGS) - jnp.cos(s.phi) * np.sin(LAGS))

    def rates(self, p: Any, s: Any) -> Any:
        return {"phi": p.omega}

    @gs.event("the oscillator begins a turn", section=True)
    def turn(self, p: Any, s: Any) -> Any:
        return s.phi - 2.0 * jnp.pi

    @turn.jump
    def wrap(self, p: Any, s: Any) -> Any:
        return s.replace(phi=s.phi - 2.0 * jnp.pi)

    @gs.observable("m/s", "speed of the trunk", scale=1.0)
    def speed(self, p: Any, s: Any) -> Any:
        return self.rate(s, "x")

    def period(self, p: Any) -> Any:
        return 2.0 * jnp.pi / p.omega


WALKER = Path(gs.__file__).parent / "examples" / "walkers" / "quadruped.xml"
TROT = np.repeat([0.0, np.pi, np.pi, 0.0], 2)  # phases of the motors of each leg, rad
HIP, SWING, LIFT = 0.7227, 0.2, 0.3  # rad: a leg at rest, the amplitudes of hips and knees
SHIN = 0.2  # m
QUADRUPED_CYCLES = 10


def trotting(phi: Any, of: Any) -> Any:
    """The targets (8,) of hips and knees in turn at a phase (rad); `of` is NumPy or its JAX namespace."""
    is_knee = np.tile([False, True], 4)
    rest = np.where(is_knee, -2.0 * HIP, HIP)
    sine, cosine = of.sin(phi), of.cos(phi)
    swing = SWING * (sine * np.cos(TROT) + cosine * np.sin(TROT))
    lift = -LIFT * of.maximum(0.0, cosine * np.cos(TROT) - sine * np.sin(TROT))
    return rest + of.where(is_knee, lift, swing)


class Quadruped(gs.BodyModel):
    """The quadruped of the examples, in an open-loop trot; the section is the phase 0."""

    body_file = str(WALKER)
    formulas = {  # noqa: RUF012 - as a user writes it
        **{f"thigh_{leg}_mass": "thigh_lf_mass" for leg in ("rf", "lh", "rh")},
        **{f"shin_{leg}_size": "shin_lf_size" for leg in ("rf", "lh", "rh")},
    }
    # the same oscillator
    phi = Cheetah.phi
    omega = Cheetah.omega
    rates = Cheetah.rates
    period = Cheetah.period
    turn = Cheetah.turn

    def control(self, p: Any, s: Any) -> Any:
        return trotting(s.phi, jnp)

    @gs.observable("m", "height of the trunk", scale=0.1)
    def height(self, p: Any, s: Any) -> Any:
        return s.q[2]


def legs(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Masses of thighs (kg) and factors of shins (1), (n,) each."""
    random = np.random.default_rng(0)
    return random.uniform(0.4, 0.8, n), random.uniform(0.9, 1.1, n)


def quadruped_rate(seconds: float, lanes: int | None) -> Rate:
    """The rate of sweeps over masses and lengths of legs."""

    def rows_of(n: int) -> tuple[Values, Values]:
        mass, size = legs(n)
        return {"thigh_lf_mass": mass, "shin_lf_size": size}, {}

    numerics = Numerics(dt=STEP, method="rk4")
    return sweep_rate(
        Quadruped(), numerics, "kernel", QUADRUPED_CYCLES, rows_of, seconds=seconds, lanes=lanes
    )


def quadruped_in_mujoco(seconds: float) -> tuple[str, Rate]:
    """The same rows by MuJoCo C in processes."""
    steps = round(QUADRUPED_CYCLES * 2.0 * np.pi / OMEGA / STEP)
    control = np.stack([trotting(OMEGA * STEP * step, np) for step in range(steps)])
    names = ("lf", "rf", "lh", "rh")
    # about as many rows as one core makes in that time
    masses, sizes = legs(max(64, int(40 * cores() * seconds / 5.0)))
    rows = [
        {f"thigh_{leg}_mass": mass for leg in names} | {f"shin_{leg}_length": SHIN * size for leg in names}
        for mass, size in zip(masses.tolist(), sizes.tolist(), strict=True)
    ]
    return changed_bodies(WALKER, rows, control, STEP)


def first_sweeps() -> list[tuple[float, float]]:
    """Seconds of the clock and of CPU time of a new Python with its first sweep, without and with a cache."""
    code = (
        "import numpy as np, gaitsweep as gs; from benchmarks.bodies import Cheetah; "
        "gs.sweep(Cheetah(), drive=np.linspace(0.2, 0.8, 16), run={'kind': 'fixed_time', 'duration': 1.0}, "
        "numerics={'method': 'rk4', 'dt': 0.002}, verify=0)"
    )
    with tempfile.TemporaryDirectory() as folder:
        return [run([sys.executable, "-c", code], Path(folder, "cache")) for _ in range(2)]


def gaitsweep_rate(seconds: float, lanes: int | None) -> Rate:
    """The rate of sweeps over the drive and a mass."""

    def rows_of(n: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        random = np.random.default_rng(0)
        return {"drive": random.uniform(0.2, 0.8, n), "torso_mass": random.uniform(6.0, 10.0, n)}, {}

    cycles = CYCLES[jax.default_backend()]
    return sweep_rate(
        Cheetah(), Numerics(dt=STEP, method="rk4"), "kernel", cycles, rows_of, seconds=seconds, lanes=lanes
    )


def in_mujoco(integrator: str, seconds: float) -> Rate:
    """The rate of MuJoCo C with the same drives."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(CHEETAH)  # type: ignore[attr-defined]
    model.opt.timestep = STEP
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")  # type: ignore[attr-defined]
    rows, steps = 16 * cores(), 500
    drive = np.random.default_rng(0).uniform(0.2, 0.8, (rows, 1, 1))
    phase = OMEGA * STEP * np.arange(steps)
    control = drive * np.sin(phase[:, None] - LAGS)
    return mujoco_c(model, np.zeros((1, model.nq)), seconds, control)


def main() -> None:
    options = argparse.ArgumentParser(
        prog="python -m benchmarks.bodies",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    options.add_argument(
        "--lanes", type=int, help="rows at once on each device; by default, the engine's own"
    )
    options.add_argument("--mjx", action="store_true", help="measure MJX too")
    chosen = options.parse_args()
    jax.config.update("jax_enable_x64", True)
    devices = local_devices(None)
    print(f"{len(devices)} x {devices[0].device_kind}; load average {os.getloadavg()[0]:.2f}; float64")
    threads = cores()
    rates = [
        ("gaitsweep, kernel, contacts located", gaitsweep_rate(chosen.seconds, chosen.lanes)),
        (f"MuJoCo C, {threads} threads, Euler", in_mujoco("EULER", chosen.seconds)),
        (f"MuJoCo C, {threads} threads, RK4", in_mujoco("RK4", chosen.seconds)),
    ]
    if chosen.mjx:
        import mujoco

        model = mujoco.MjModel.from_xml_string(CHEETAH)  # type: ignore[attr-defined]
        rows = 131072 if jax.default_backend() == "gpu" else 128
        begin = np.zeros((rows, model.nq))
        rates.append((f"MJX on the {devices[0].platform}", mjx_alone(model, begin, chosen.seconds)))
    print_rates(rates)
    print("\nquadruped, rows over masses and lengths of legs")
    by, rate = quadruped_in_mujoco(chosen.seconds)
    ours = quadruped_rate(chosen.seconds, chosen.lanes)
    print_rates([(rates[0][0], ours), (f"MuJoCo C, {threads} processes of {by}", rate)])
    work = 1e4 * QUADRUPED_CYCLES * 2.0 * np.pi / OMEGA  # simulated s
    print(f"10 000 rows take {work / ours.simulated:.0f} s and {work / rate.simulated:.0f} s")
    for (clock, spent), cache in zip(first_sweeps(), ("no cache", "cached kernels"), strict=True):
        print(f"first sweep in a new Python, {cache}: {clock:.1f} s, {spent:.1f} s of CPU time")


def print_rates(rates: list[tuple[str, Rate]]) -> None:
    """Print a table of rates with their ratio to the first."""
    base = rates[0][1].simulated
    print(f"{'':46} {'steps/s':>10} {'simulated s/s':>14} {'ratio':>8} {'ready after s':>13}")
    for name, (steps, simulated, ready) in rates:
        print(f"{name:46} {steps:10.3g} {simulated:14.4g} {base / simulated:8.3g} {ready:13.1f}")


if __name__ == "__main__":
    main()
