"""A basin of 33 x 33 starts as one writes it by hand with joblib and SciPy, beside one call here.

The simplest walker from stance angles and rates around its gait: has it taken 30 steps, or fallen? The error
is the share of starts whose answers differ from those of SciPy at rtol 1e-11. Lines of code are those of the
functions below, without docstrings, comments and blanks, equations and model included.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tests.support.models.simplest_walker import SimplestWalker

from .measured import Array, Line, Options, installed, missing, swept, timed, version_of

SLOPE, STEPS, SIDE = 0.009, 30, 33
ANGLES, RATES = (0.16, 0.24), (-0.24, -0.16)  # rad and rad per unit of time, around the gait
CORES = 2


def lines(options: Options) -> Iterator[Line]:
    """The lines of joblib with SciPy and of gaitsweep."""
    side = round(options.rows_or(SIDE**2)[0] ** 0.5)
    angles, rates = np.linspace(*ANGLES, side), np.linspace(*RATES, side)
    right = None
    if installed("joblib") is None:
        yield missing("joblib")
    else:
        right, _ = by_hand(angles, rates, 1e-11)
        began = time.perf_counter()
        walks, cpu = by_hand(angles, rates, 1e-8)
        clock = time.perf_counter() - began
        name = f"{version_of('joblib')}, {version_of('scipy')}, {side} x {side}, rtol 1e-8, {CORES} processes"
        note = (
            f"{code_lines(row_by_hand, by_hand)} lines of code with the equations; yes or no, no table; "
            f"{100.0 * np.mean(walks):.1f} % walk"
        )
        yield Line(name, cpu, clock, float(np.mean(walks != right)), note)
    one_call(angles, rates)  # compiles
    walks, cpu, clock = timed(lambda: one_call(angles, rates), options.repeats)
    error = float("nan") if right is None else float(np.mean(walks != right))
    note = f"{code_lines(one_call)} lines of code for the call, {code_lines(SimplestWalker)} for the model"
    yield Line(f"gaitsweep, {side} x {side}, default numerics", cpu, clock, error, note)


def row_by_hand(theta: float, rate: float, rtol: float) -> tuple[bool, float]:
    """Whether one walker takes all steps, and its CPU time (s)."""
    began = time.process_time()

    def flow(t, s):
        fall = np.sin(s[0] - SLOPE)
        return [s[1], fall, s[3], fall + (s[1] ** 2 - np.cos(s[0] - SLOPE)) * np.sin(s[2])]

    def strike(t, s):
        return s[2] - 2.0 * s[0] if t > 0.5 else 1.0

    def fallen(t, s):
        return abs(s[0]) - 1.0

    strike.terminal, strike.direction, fallen.terminal = True, 1.0, True  # type: ignore[attr-defined]
    state = [theta, rate, 2.0 * theta, (1.0 - np.cos(2.0 * theta)) * rate]
    for _ in range(STEPS):
        run = solve_ivp(
            flow, (0.0, 30.0), state, "DOP853", events=[strike, fallen], rtol=rtol, atol=rtol, max_step=0.1
        )
        if run.status != 1 or not run.t_events[0].size:
            return False, time.process_time() - began
        theta, rate = -run.y[0, -1], np.cos(2.0 * run.y[0, -1]) * run.y[1, -1]
        state = [theta, rate, 2.0 * theta, (1.0 - np.cos(2.0 * theta)) * rate]
    return True, time.process_time() - began


def by_hand(angles: Array, rates: Array, rtol: float) -> tuple[NDArray[np.bool_], float]:
    """Whether each walker takes all steps, and the CPU time (s) of all."""
    joblib = installed("joblib")
    jobs = (joblib.delayed(row_by_hand)(theta, rate, rtol) for theta in angles for rate in rates)
    walks, seconds = zip(*joblib.Parallel(n_jobs=CORES)(jobs), strict=True)
    return np.array(walks), sum(seconds)


def one_call(angles: Array, rates: Array) -> NDArray[np.bool_]:
    """The same by gaitsweep."""
    table = swept(
        SimplestWalker(), {"kind": "settle", "max_cycles": STEPS, "tolerance": 1e-30}, {},
        theta_0=angles, theta_rate_0=rates, phi_0="2*theta_0", phi_rate_0="(1-cos(2*theta_0))*theta_rate_0",
    )  # fmt: skip
    return (table["cycles"] == STEPS).to_numpy()


def code_lines(*objects: Callable) -> int:
    """Lines of code of functions and classes, without comments, docstrings and blanks."""
    total = 0
    for code in objects:
        # source without comments and docstrings, on as few lines as it needs
        tree = ast.parse(textwrap.dedent(inspect.getsource(code)))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node):
                node.body = node.body[1:]
        total += sum(bool(line.strip()) for line in ast.unparse(tree).splitlines())
    return total
