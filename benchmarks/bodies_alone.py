"""Speed of MuJoCo C and MJX with a body alone, without oscillators: motors follow given controls, or rest."""

from __future__ import annotations

import concurrent.futures
import functools
import importlib.util
import multiprocessing
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.sweep_rate import Rate


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def mujoco_c(model: Any, begin: np.ndarray, seconds: float, control: np.ndarray | None = None) -> Rate:
    """mujoco.rollout on as many threads as there are cores.

    Args:
        model: a mujoco.MjModel, its option's step the one to take.
        begin: positions (n, nq) from which rows start at rest.
        seconds: of the measurement.
        control: controls (16 rows for each core, 500 steps, nu); by default none.
    """
    import mujoco
    from mujoco import rollout

    threads, steps = cores(), 500
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS  # type: ignore[attr-defined]
    data = mujoco.MjData(model)  # type: ignore[attr-defined]
    states = np.zeros((16 * threads, mujoco.mj_stateSize(model, full)))  # type: ignore[attr-defined]
    for row, qpos in zip(states, np.resize(begin, (len(states), begin.shape[1])), strict=True):
        mujoco.mj_resetData(model, data)  # type: ignore[attr-defined]
        data.qpos[:] = qpos
        mujoco.mj_getState(model, data, row, full)  # type: ignore[attr-defined]
    workers = [mujoco.MjData(model) for _ in range(threads)]  # type: ignore[attr-defined]
    best = np.inf
    with rollout.Rollout(nthread=threads) as pool:
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            began = time.perf_counter()
            pool.rollout(model, workers, states, control, nstep=steps)
            best = min(best, time.perf_counter() - began)
    rate = len(states) * steps / best
    return Rate(rate, rate * model.opt.timestep, 0.0)


def changed_bodies(
    file: Path, rows: Sequence[Mapping[str, float]], control: np.ndarray, timestep: float
) -> tuple[str, Rate]:
    """MuJoCo C over rows of masses and lengths, each compiled from the MJCF, in one process for each core.

    The processes are joblib's where it is installed, and else those of concurrent.futures.

    Args:
        file: the MJCF; rows start at its first keyframe.
        rows: for each row, masses (kg) of bodies and lengths (m) of capsules by the names of their elements.
        control: controls (steps, nu).
        timestep: s.

    Returns:
        What computed the rows, and the rate.
    """
    work = functools.partial(_changed_body, file, control, timestep)
    has_joblib = importlib.util.find_spec("joblib") is not None
    if has_joblib:
        import joblib  # pyright: ignore[reportMissingImports] (not installed with gaitsweep)

        with joblib.Parallel(n_jobs=cores()) as parallel:
            parallel(joblib.delayed(work)(row) for row in rows[: 2 * cores()])  # imports
            began = time.perf_counter()
            parallel(joblib.delayed(work)(row) for row in rows)
            seconds = time.perf_counter() - began
    else:
        spawn = multiprocessing.get_context("spawn")
        with concurrent.futures.ProcessPoolExecutor(cores(), mp_context=spawn) as pool:
            list(pool.map(work, rows[: 2 * cores()]))
            began = time.perf_counter()
            list(pool.map(work, rows, chunksize=4))
            seconds = time.perf_counter() - began
    rate = len(rows) * len(control) / seconds
    return "joblib" if has_joblib else "a process pool", Rate(rate, rate * timestep, 0.0)


def _changed_body(file: Path, control: np.ndarray, timestep: float, row: Mapping[str, float]) -> np.ndarray:
    """The last state of a row of `changed_bodies`."""
    import mujoco
    from mujoco import rollout

    spec = mujoco.MjSpec.from_file(str(file))  # type: ignore[attr-defined]
    spec.option.timestep = timestep
    for name, value in row.items():
        element, _, attribute = name.rpartition("_")
        if attribute == "mass":
            spec.geom(element).mass = value
        else:
            spec.geom(element).fromto = [0.0, 0.0, 0.0, 0.0, 0.0, -value]
    model = spec.compile()
    data = mujoco.MjData(model)  # type: ignore[attr-defined]
    mujoco.mj_resetDataKeyframe(model, data, 0)  # type: ignore[attr-defined]
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS  # type: ignore[attr-defined]
    start = np.zeros(mujoco.mj_stateSize(model, full))  # type: ignore[attr-defined]
    mujoco.mj_getState(model, data, start, full)  # type: ignore[attr-defined]
    states, _ = rollout.rollout(model, data, start, control)
    return np.asarray(states)[0, -1]


def mjx_alone(model: Any, begin: np.ndarray, seconds: float, dtype: str = "float64") -> Rate:
    """MJX, vmapped over the rows of `begin` (n, nq) and jitted; else as `mujoco_c`."""
    # MJX makes its arrays in the default precision
    with jax.enable_x64(dtype == "float64"):
        return _mjx_alone(model, begin, seconds)


def _mjx_alone(model: Any, begin: np.ndarray, seconds: float) -> Rate:
    from mujoco import mjx

    body, data = mjx.put_model(model), mjx.make_data(model)
    steps = 100 if jax.default_backend() == "gpu" else 50

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
    rate = len(begin) * steps / best
    return Rate(rate, rate * model.opt.timestep, compiled)
