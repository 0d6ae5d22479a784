"""Result directories of a toy job."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from gaitsweep.table import ResultDirectory
from gaitsweep.table.frames import outcomes
from gaitsweep.table.manifest import Layout

JOB = {"name": "toy", "model": "toy", "vary": {"a": [0.0, 1.0]}}


GAITS = ["direct", "source", "none"]


STATUSES = ["settled", "cycle_limit", "fell"]


def block_frame(start: int, stop: int) -> pd.DataFrame:
    """Make the records of some rows of a settle table, the same ones each time."""
    rows = np.arange(start, stop, dtype=np.int64)
    noise = (
        np.random.default_rng(rows[0]).uniform(0, 2 * np.pi, (3, len(rows)))
        if len(rows)
        else np.zeros((3, 0))
    )
    status = pd.Categorical.from_codes(rows % 3 // 2 * (rows % 2), STATUSES)
    gait = pd.Categorical.from_codes(rows % 4 - 1, GAITS)  # -1: no gait
    return pd.DataFrame(
        {
            "row": rows,
            "a": rows / 7.0,
            "status": status,
            "cycles": rows % 150,
            "psi_1_end": noise[0],
            "psi_2_end": noise[1],
            "psi_3_end": noise[2],
            "gait": gait,
            "outcome": outcomes(gait, status),
        }
    )


def open_toy(path: Path, rows: int = 10, block: int = 4, job_hash: str = "abc" * 20) -> ResultDirectory:
    return ResultDirectory.open(path, JOB, Layout(job_hash, rows, block))


def fill(directory: ResultDirectory) -> None:
    for number in directory.missing_blocks():
        directory.write_part(number, block_frame(*directory.layout.rows_of(number)))


def files_of(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}
