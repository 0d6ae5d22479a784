"""Names that older versions wrote into jobs, and their present names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

RUN_KINDS = {"hold": "fixed_time"}
RUN_FIELDS: Mapping[str, Mapping[str, str]] = {
    "ramp": {"hold": "initial_dwell"},
    "trace": {"hold": "initial_dwell"},
    "staircase": {"hold": "dwell", "first_hold": "first_dwell"},
}
METHODS = {"exact": "propagator", "stabilised": "propagator6"}


def renamed(job: dict[str, Any]) -> dict[str, Any]:
    """A job with the present names; the same object if it has no older ones."""
    run = job.get("run")
    numerics = job.get("numerics")
    changed: dict[str, Any] = {}
    if isinstance(run, dict) and isinstance(run.get("kind"), str):
        fields = RUN_FIELDS.get(run["kind"], {})
        renamed_run = {fields.get(name, name): value for name, value in run.items()}
        renamed_run["kind"] = RUN_KINDS.get(run["kind"], run["kind"])
        if renamed_run != run:
            changed["run"] = renamed_run
    if isinstance(numerics, dict) and isinstance(numerics.get("method"), str):
        method = METHODS.get(numerics["method"], numerics["method"])
        if method != numerics["method"]:
            changed["numerics"] = {**numerics, "method": method}
    return {**job, **changed} if changed else job
