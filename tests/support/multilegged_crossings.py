"""Crossings of the multi-legged model, and those of the reference."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from gaitsweep.engine.numerics import Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.status import Status
from tests.support import REFERENCE
from tests.support.sweeping import run_rows

FILE = REFERENCE / "multilegged_crossings.csv"


def wrapped(difference: ArrayLike) -> np.ndarray:
    """The absolute value of a difference of angles (rad), by the shorter way."""
    return np.abs((np.asarray(difference) + np.pi) % (2 * np.pi) - np.pi)


def reference(name: str) -> tuple[dict, pd.DataFrame]:
    """One set of reference starts: its parameters and its crossings."""
    header = re.search(rf"^# set {name}: \d+ starts, (.*)$", FILE.read_text(), re.MULTILINE)
    assert header is not None
    table = pd.read_csv(FILE, comment="#")
    return json.loads(header[1]), table.loc[table["set"] == name]


def simulated(
    params: dict, psi: np.ndarray, crossings: int, devices: int = 2
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Crossings of the model from psi (rows, N): t, psi, landed, (rows, crossings + 1, ...)."""
    params = {k: float(v) for k, v in params.items()}
    model = Multilegged(int(params.pop("N", 3)))
    starts = {f"psi_{i + 1}": psi[:, i] for i in range(model.N)}
    # a ground that cannot pull is not linear, and the recommended method takes it for its tangent
    numerics = Numerics(method="rk4") if params.get("clamp") else Numerics()
    options = {"params": params, "lanes": 32, "devices": devices, "numerics": numerics}
    result = run_rows(model, CrossingRecorder(model, crossings=crossings), starts, **options)
    assert np.all(result.status == Status.complete)
    samples = result.samples.reshape(len(psi), crossings + 1, -1)
    return samples[:, :, 1], samples[:, :, 2:-1], samples[:, :, -1]
