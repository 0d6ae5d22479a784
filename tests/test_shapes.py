"""Arrays have the axes that annotations give them, where these are checked (`pytest --shapes` checks all)."""

from __future__ import annotations

import subprocess
import sys

import pytest

CHECKED = """
import sys
from tests.support.shapes import check_shapes

check_shapes()
"""

JOBS = """
import numpy as np
import gaitsweep as gs
from gaitsweep.examples.hopper import Hopper

# a settle job by both engines, a trace and a return map
launch = np.linspace(1.0, 6.0, 4)
tables = [
    gs.sweep(Hopper(), launch_0=launch, run=gs.Settle(max_cycles=40), engine=engine).table
    for engine in ("xla", "kernel")
]
print(*tables[0]["launch_end"].round(6))
assert tables[1]["launch_end"].round(6).equals(tables[0]["launch_end"].round(6))
trace = gs.simulate(Hopper(), duration=1.0, launch_0=3.0)
print(len(trace), trace["launch"].iloc[-1].round(6))
mapping = gs.return_map(Hopper())
print(*mapping(np.array([0.4, 3.0])).round(6), *mapping.jacobian(np.array([0.4, 3.0])).round(4).ravel())
"""

WRONG = """
import numpy as np
from gaitsweep.angles import mean_direction
from gaitsweep.engine.poincare.maps import Points, wrap_difference
from gaitsweep.engine.carry import unpacked
from gaitsweep.engine.recorders.recorder import Readings
from gaitsweep.row_outcome import RowOutcome
import jaxtyping

for wrong in (
    lambda: wrap_difference(np.zeros((5, 3)), np.zeros(2, bool)),  # 3 coordinates, and flags of 2
    lambda: mean_direction(np.zeros((2, 2))),
    lambda: unpacked(np.zeros((2, 1))),  # no whole numbers
    lambda: Readings(np.arange(3), np.zeros(3), np.zeros((2, 4)), np.ones(3, bool)),
    lambda: RowOutcome(np.arange(3), {}, np.zeros(2, int), np.zeros((0, 1))),
):
    try:
        wrong()
    except jaxtyping.TypeCheckError:
        continue
    sys.exit("A wrong shape was not caught.")
"""


def printed_by(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_jobs_have_the_shapes_of_annotations() -> None:
    """A run of each engine, a trace and a map; the results are those without checks, which users have."""
    assert printed_by(CHECKED + JOBS) == printed_by(JOBS)


@pytest.mark.slow
def test_a_wrong_shape_is_caught() -> None:
    assert printed_by(CHECKED + WRONG) == ""


def test_users_arrays_are_not_checked() -> None:
    code = """
import sys, numpy as np
from gaitsweep.engine.poincare.maps import wrap_difference
wrap_difference(np.zeros((5, 3)), np.zeros(1, bool))
print("beartype" in sys.modules, hasattr(wrap_difference, "__wrapped__"))
"""
    assert printed_by(code).split() == ["False", "False"]
