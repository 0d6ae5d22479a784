"""Rival: diffrax, vmapped, events located by its root finder, jumps by restarting `diffeqsolve`.

diffrax ends a solve at an event but cannot jump: an outer `while_loop` applies the jump and starts the next
solve. Of several events in one step diffrax locates the first of its list, not the earliest: so it gets
one condition, the largest of all guards.

diffrax is no dependency of gaitsweep. Where it is not installed, DIFFRAX_PYTHON may name an interpreter
that has it (with numpy and scipy); without both the row says so.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from .starts import Array, Parameters, Row, errors, reference_crossings, stacked, states

NAME = "diffrax, located events, restarts"
FIRST_STEP = 1e-6  # s; lets a guard that has just been armed leave its zero before diffrax reads its sign


def missing(note: str) -> Row:
    nan = float("nan")
    return {"name": NAME, "steps_per_second": nan, "cycles_per_second": nan, "error_rad": nan, "note": note}


def measure(lanes: int = 256, crossings: int = 1, rtol: float = 1e-5, solver: str = "Tsit5") -> Row:
    """Run the reference's starts in this interpreter, or in the one that DIFFRAX_PYTHON names."""
    if importlib.util.find_spec("diffrax") is not None:
        return _measure(lanes, crossings, rtol, solver)
    python = os.environ.get("DIFFRAX_PYTHON")
    if not python:
        return missing("not measured: diffrax is not installed, and DIFFRAX_PYTHON is not set")
    arguments = [
        python,
        "-m",
        "benchmarks.rivals.diffrax_events",
        str(lanes),
        str(crossings),
        str(rtol),
        solver,
    ]
    done = subprocess.run(arguments, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    if done.returncode:
        return missing(f"not measured: {python} failed: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return json.loads(done.stdout.splitlines()[-1])


def _equations(p: Parameters) -> tuple[Any, Any]:
    """The vector field of z = (x - L, v, phi, y), each (N+1,), and the guards (positive: happened)."""
    import jax.numpy as jnp

    slopes, origins, corners = jnp.asarray(p.slopes), jnp.asarray(p.origins), jnp.asarray(p.corners)
    mass, link = jnp.asarray(p.mass), jnp.asarray(p.neighbours)

    def flow(t, z, modes):
        x, v, phi, y = z
        contact, segment = modes
        slope = slopes[segment]
        gap = x - slope * (phi - origins[segment])
        closing = v - slope * (p.omega + y)
        force = link @ (p.kappa * x + p.spring_damper * v)
        force = force + contact * (p.K * gap + p.ground_damper * closing)
        return jnp.stack([v, -p.g - force / mass, p.omega + y, -y / p.tau])

    def guards(z, modes):
        contact, segment = modes
        gap = slopes[segment] * (z[2] - origins[segment]) - z[0]
        return jnp.stack([jnp.where(contact, -gap, gap), z[2] - corners[segment]])

    return flow, guards


def _program(p: Parameters, crossings: int, rtol: float, solver: str) -> Any:
    """A jitted function from (z, contact, segment, landed) of all lanes to (psi at crossings, steps)."""
    import jax
    import jax.numpy as jnp

    diffrax, optimistix = import_module("diffrax"), import_module("optimistix")
    jax.config.update("jax_enable_x64", True)
    flow, guards = _equations(p)
    corners, turn = jnp.asarray(p.corners), 2.0 * jnp.pi
    event = diffrax.Event(
        lambda t, y, args, **_: guards(y, args).max(),
        root_finder=optimistix.Bisection(rtol=0.0, atol=1e-12),
        direction=True,
    )
    controller = diffrax.PIDController(rtol=rtol, atol=1e-3 * rtol)

    def advance(carry):
        z, contact, segment, landed, recorded, count, steps = carry
        modes = (contact, segment)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(flow), getattr(diffrax, solver)(), 0.0, 40.0, FIRST_STEP, z, modes, event=event,
            stepsize_controller=controller, adjoint=diffrax.ForwardMode(), max_steps=100_000, throw=False,
        )  # fmt: skip
        z = solution.ys[-1]
        # The bisection ends on either side of the event: what is within its tolerance has happened.
        reached = guards(z, modes)
        happened = reached >= jnp.minimum(reached.max(), -1e-11)
        switch, ended = happened
        kicked = switch & ~contact & (segment == 2)
        wrapped = ended & (segment == 2)
        closed = (kicked[0] | wrapped[0]) & ~landed
        psi = jnp.diff(z[2]) % turn
        recorded = jnp.where(closed, recorded.at[count].set(psi, mode="drop"), recorded)
        y = z[3] + kicked * (turn - z[2]) / p.tau
        phi = jnp.where(ended, jnp.where(wrapped, 0.0, corners[segment]), z[2])
        z = jnp.stack([z[0], z[1], phi, y])
        landed = (landed | kicked[0]) & ~wrapped[0]
        count, steps = count + closed, steps + solution.stats["num_steps"]
        return z, contact ^ switch, (segment + ended) % 3, landed, recorded, count, steps

    def run(z, contact, segment, landed):
        recorded = jnp.full((crossings, p.N), jnp.nan)
        carry = (z, contact, segment, landed, recorded, 0, 0)
        end = jax.lax.while_loop(lambda carry: carry[5] < crossings, advance, carry)
        return end[4], end[6]

    return jax.jit(jax.vmap(run))


def _measure(lanes: int, crossings: int, rtol: float, solver: str) -> Row:
    diffrax = import_module("diffrax")
    p = Parameters()
    true: Array = reference_crossings()
    true = true[np.arange(lanes) % len(true)]
    begin = states(p, true[:, 0])
    z = np.stack([stacked(begin, name) for name in ("x", "v", "phi", "y")], axis=1)
    arguments = (
        z, stacked(begin, "contact") > 0.0, stacked(begin, "segment").astype(int), np.ones(lanes, bool)
    )  # fmt: skip
    begun = time.perf_counter()
    compiled = _program(p, crossings, rtol, solver).lower(*arguments).compile()
    compilation = time.perf_counter() - begun
    begun = time.perf_counter()
    recorded, steps = (np.asarray(part) for part in compiled(*arguments))
    seconds = time.perf_counter() - begun
    error = errors(recorded, true[:, 1 : crossings + 1])
    return {
        "name": NAME,
        "steps_per_second": float(steps.sum() / seconds),
        "cycles_per_second": lanes * crossings / seconds,
        "error_rad": float(np.quantile(error, 0.95)),
        "note": f"diffrax {diffrax.__version__}, {solver}, rtol {rtol:g}, {lanes} lanes, {crossings} cycles, "
        f"{steps.mean() / crossings:.0f} steps a cycle, median error {np.median(error):.1e} rad, "
        f"compiled in {compilation:.0f} s",
    }


if __name__ == "__main__":
    if len(sys.argv) == 5:
        print(json.dumps(measure(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4])))
    else:
        print(json.dumps(measure()))
