"""Compact encodings of numbers for a page: integers of two bytes, differences of similar neighbours."""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from gaitsweep.view.explorer.replays import Crossings, Motion

RESOLUTION = 1e-3  # of stored pictures, as a share of the body's height
# Integers of two bytes: the largest in magnitude that is a number, and the one for a missing number.
_LARGEST = 32767
_NO_NUMBER = -32768


def packed(numbers: Real[np.ndarray, ...]) -> str:
    """Integers (n,) of two bytes as text: the low bytes, then the high ones, which compress better.

    Args:
        numbers: whole numbers that fit into two bytes; callers encode missing ones as `_NO_NUMBER`.
    """
    assert np.all((numbers >= _NO_NUMBER) & (numbers <= _LARGEST)), (
        "a number is NaN or has more than two bytes"
    )
    planes = numbers.astype("<i2").reshape(-1).view(np.uint8).reshape(-1, 2).T
    return base64.b64encode(planes.tobytes()).decode()


def compressed(text: bytes) -> str:
    """Bytes compressed by gzip, as base64 text."""
    return base64.b64encode(gzip.compress(text, 9, mtime=0)).decode()


def json_bytes(fields: Any) -> bytes:
    """Fields as JSON without spaces; NaN, which browsers do not read, raises ValueError."""
    text = json.dumps(fields, separators=(",", ":"), ensure_ascii=False, default=_plain, allow_nan=False)
    return text.encode()


def _plain(value: Any) -> Any:
    """Convert a NumPy scalar, which JSON does not know, to a number of Python."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value)} is not JSON")


def motion_fields(motion: Motion) -> dict[str, Any]:
    """A stretch of motion in the format of the page.

    Each column of `points` is stored as differences from frame to frame, the first from 0, in units of
    `unit` m; the last column is the camera's path. `contact` has, for each limb, the samples at which ground
    contact alternately begins and ends.
    """
    stretch, t = motion.stretch, motion.t
    # a single sample has no interval; the page divides by it, so it is any above 0
    interval = float(t[-1] - t[0]) / (len(t) - 1) if len(t) > 1 else 1.0
    fields: dict[str, Any] = {
        "name": stretch.name,
        "begin": round(float(t[0]), 6),
        "sample": _digits(interval),
        "samples": len(t),
        "stride": motion.stride,
        "loops": stretch.loops,
        "contact": [_turns(column > 0.5) for column in motion.contact.T],
    }
    if motion.pictures is not None:
        pictures = motion.pictures
        unit = RESOLUTION * pictures.height
        columns = np.column_stack([pictures.points, pictures.camera - pictures.camera[0]])
        in_units = np.rint(columns / unit)
        steps = np.diff(in_units, axis=0, prepend=np.zeros((1, in_units.shape[1])))
        steps = np.clip(steps, -_LARGEST, _LARGEST)  # less than 32 heights from one picture to the next
        fields |= {
            "unit": _digits(unit),
            "ground": _digits(float(pictures.camera[0])),
            "pictures": len(in_units),
            "points": packed(steps.T.ravel()),
        }
    return fields


def crossing_fields(
    crossings: Crossings,
    shown: Int[np.ndarray, " shown"],
    low: Float[np.ndarray, " shown"],
    high: Float[np.ndarray, " shown"],
) -> dict[str, Any]:
    """Observables over the crossings of a row in the format of the page, as fractions from low to high.

    Args:
        crossings: the crossings of the row.
        shown: numbers of the observables, (k,).
        low, high: their ranges, (k,), each in the unit of its observable.
    """
    values = crossings.observed[:, shown]
    share = (values - low) / np.where(high > low, high - low, 1.0)
    integers = np.rint(share * 2.0 * _LARGEST) - _LARGEST
    integers = np.where(np.isfinite(integers), np.clip(integers, -_LARGEST, _LARGEST), _NO_NUMBER)
    return {"first": int(crossings.number[0]) if len(crossings.number) else 0, "values": packed(integers.T)}


def _turns(down: Bool[np.ndarray, " samples"]) -> list[int]:
    """The samples at which a limb alternately lands and lifts, from its contact (n,)."""
    return np.flatnonzero(np.diff(np.r_[False, down, False])).tolist()


def _digits(number: float) -> float:
    """A number to nine significant digits."""
    return float(f"{number:.9g}")
