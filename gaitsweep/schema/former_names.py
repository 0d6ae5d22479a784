"""Names in jobs of older versions, and their present names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

RUN_KINDS = {"hold": "fixed_time"}
# Fields of a run by its present kind.
RUN_FIELDS: Mapping[str, Mapping[str, str]] = {
    "ramp": {"hold": "initial_dwell"},
    "trace": {"hold": "initial_dwell"},
    "staircase": {"hold": "dwell", "first_hold": "first_dwell"},
}
METHODS = {"exact": "propagator", "stabilised": "propagator6"}


def renamed(job: dict[str, Any]) -> dict[str, Any]:
    """Return a stored job with the present names; the same object if it has no older ones."""
    changed: dict[str, Any] = {}
    run = job.get("run")
    if isinstance(run, dict) and isinstance(run.get("kind"), str):
        kind = run["kind"]
        fields = RUN_FIELDS.get(kind, {})
        if kind in RUN_KINDS or not fields.keys().isdisjoint(run):
            present = {fields.get(name, name): value for name, value in run.items()}
            changed["run"] = {**present, "kind": RUN_KINDS.get(kind, kind)}
    numerics = job.get("numerics")
    if isinstance(numerics, dict) and isinstance(numerics.get("method"), str):
        method = numerics["method"]
        if method in METHODS:
            changed["numerics"] = {**numerics, "method": METHODS[method]}
    return {**job, **changed} if changed else job
