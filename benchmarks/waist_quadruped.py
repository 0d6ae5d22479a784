"""How fast the quadruped runs, side by side in one run: `python -m benchmarks.waist_quadruped`.

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
import time

import jax
import numpy as np

from gaitsweep.engine.advance import Numerics
from gaitsweep.engine.crossings import Crossings
from gaitsweep.engine.engines import default_lanes
from gaitsweep.engine.sweep import Timings, sweep
from gaitsweep.engine.work import Work
from gaitsweep.engine.xla import local_devices
from gaitsweep.models.waist_quadruped import WaistQuadruped
from gaitsweep.models.waist_quadruped.mechanics import mjcf

STEP = 2e-4  # s
LOCATED = 3e-4  # s, the longest step where events are located
# Cycles of 0.4 s for each row; a row is opened on the CPU, so that a GPU's rows run as long as in a sweep.
CYCLES = {("kernel", "cpu"): 20, ("kernel", "gpu"): 100, ("xla", "cpu"): 2, ("xla", "gpu"): 2}


def ours(
    engine: str,
    method: str,
    dt: float,
    seconds: float,
    lanes: int | None,
    body: str = "tree",
    precision: str = "float64",
) -> tuple[float, float, float]:
    """Steps a second, simulated seconds a second and the seconds of compiling of whole sweeps."""
    devices, model = local_devices(None), WaistQuadruped(body)
    recorder = Crossings(model, crossings=CYCLES[engine, devices[0].platform])
    numerics = Numerics(dt=dt, method=method, precision=precision)
    gpu = devices[0].platform == "gpu"
    if engine == "xla":  # fewer rows, which run long enough
        lanes = 2**14 if gpu else 64
    lanes = lanes or default_lanes(engine, 2**17, devices[0].platform)
    defaults = {q.name: float(q.default) for q in model.parameters if not isinstance(q.default, str)}  # type: ignore[arg-type]
    simulated: list[float] = []

    def run(rows: int) -> Timings:
        random = np.random.default_rng(0)
        params = {name: np.full(rows, value) for name, value in defaults.items()}
        params["f"] = random.uniform(2.0, 3.2, rows)
        starts = {"delta_13": random.uniform(2.0, 3.2, rows)}
        work = Work(
            model=model, recorder=recorder, numerics=numerics, n_rows=rows, block=rows, lanes=lanes,
            devices=devices, values=lambda a, b: (params, starts), engine=engine,
        )  # fmt: skip
        return sweep(work, [0], lambda _, block: simulated.append(float(np.sum(block.t_end))))

    rows = lanes * len(devices)
    first = run(rows)
    repeats = int(np.clip(seconds / first.run_s, 1, 64))
    again = run(rows * repeats) if repeats > 1 else first
    return again.attempts / again.run_s, simulated[-1] / again.run_s, first.compile_s


def mujoco_c(seconds: float) -> tuple[float, float, float]:
    """The body alone in MuJoCo C, on all cores, from random states."""
    import mujoco
    from mujoco import rollout

    model = mujoco.MjModel.from_xml_string(mjcf())  # type: ignore[attr-defined]
    model.opt.timestep = STEP
    threads, steps = os.cpu_count() or 1, 500
    rows = 16 * threads
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS  # type: ignore[attr-defined]
    data = mujoco.MjData(model)  # type: ignore[attr-defined]
    begin = np.zeros((rows, mujoco.mj_stateSize(model, full)))  # type: ignore[attr-defined]
    random = np.random.default_rng(0)
    for row in begin:
        mujoco.mj_resetData(model, data)  # type: ignore[attr-defined]
        data.qpos[7:] += random.uniform(-0.3, 0.3, 9)
        mujoco.mj_getState(model, data, row, full)  # type: ignore[attr-defined]
    workers = [mujoco.MjData(model) for _ in range(threads)]  # type: ignore[attr-defined]
    best = np.inf
    with rollout.Rollout(nthread=threads) as pool:
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            began = time.perf_counter()
            pool.rollout(model, workers, begin, nstep=steps)
            best = min(best, time.perf_counter() - began)
    rate = rows * steps / best
    return rate, rate * STEP, 0.0


def mjx_alone(seconds: float, dtype: str = "float64") -> tuple[float, float, float]:
    """The body alone in MJX, vmapped over as many rows as run fastest."""
    # MJX makes its arrays in the default precision
    with jax.enable_x64(dtype == "float64"):
        return _mjx_alone(seconds)


def _mjx_alone(seconds: float) -> tuple[float, float, float]:
    import mujoco
    from mujoco import mjx

    model = mujoco.MjModel.from_xml_string(mjcf())  # type: ignore[attr-defined]
    model.opt.timestep = STEP
    body, data = mjx.put_model(model), mjx.make_data(model)
    rows, steps = (32768, 100) if jax.default_backend() == "gpu" else (256, 50)
    begin = data.qpos + np.random.default_rng(0).uniform(-0.3, 0.3, (rows, model.nq)) * (
        np.arange(model.nq) > 6
    )

    def one(qpos: jax.Array) -> jax.Array:
        def step(_: int, d: mjx.Data) -> mjx.Data:
            moved = mjx.step(body, d)
            # with 64 bits some leaves come back in another type than they went in
            return jax.tree.map(lambda new, old: new.astype(old.dtype), moved, d)

        return jax.lax.fori_loop(0, steps, step, data.replace(qpos=qpos.astype(data.qpos.dtype))).qpos

    run = jax.jit(jax.vmap(one))
    began = time.perf_counter()
    run(begin).block_until_ready()
    compiled = time.perf_counter() - began
    best = np.inf
    end = time.perf_counter() + seconds
    while True:
        began = time.perf_counter()
        run(begin).block_until_ready()
        best = min(best, time.perf_counter() - began)
        if time.perf_counter() > end:
            break
    rate = rows * steps / best
    return rate, rate * STEP, compiled


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
    found: list[tuple[str, str, tuple[float, float, float]]] = []
    cases = [
        ("kernel", "semi_implicit", "tree", "float64"),
        ("kernel", "semi_implicit", "tree", "mixed"),
        ("xla", "semi_implicit", "mjx", "float64"),
    ]
    if not chosen.quick:
        cases += [("kernel", "rk4", "tree", "float64"), ("xla", "semi_implicit", "tree", "float64")]
    for engine, method, body, precision in cases:
        dt = STEP if method == "semi_implicit" else LOCATED
        lanes = chosen.lanes if engine == "kernel" else None
        rates = ours(engine, method, dt, chosen.seconds, lanes, body, precision)
        in_mixed = ", mixed precision" if precision == "mixed" else ""
        found.append((f"gaitsweep, {engine}, {body}, {names[method]}{in_mixed}", precision, rates))
    threads, platform = os.cpu_count(), devices[0].platform
    found.append((f"MuJoCo C, {threads} threads, body alone", "float64", mujoco_c(chosen.seconds)))
    found.append((f"MJX on the {platform}, body alone", "float64", mjx_alone(chosen.seconds)))
    single = mjx_alone(chosen.seconds, "float32")
    found.append((f"MJX on the {platform}, body alone, single", "mixed", single))
    base = {"float64": found[0][2][1], "mixed": found[1][2][1]}
    print(f"{'':62} {'steps/s':>10} {'simulated s/s':>14} {'ratio':>8} {'ready in, s':>12}")
    for name, precision, (steps, simulated, ready) in found:
        print(f"{name:62} {steps:10.3g} {simulated:14.4g} {base[precision] / simulated:8.3g} {ready:12.1f}")


if __name__ == "__main__":
    main()
