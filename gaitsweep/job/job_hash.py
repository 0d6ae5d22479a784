"""The hash of everything in a job that decides its numbers."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from gaitsweep.kinds import RunKind

_HASHED_FORM = 4  # raised when the meaning of a resolved job changes, so that no old directory is resumed


def job_hash(resolved: dict[str, Any], run: RunKind, engine: dict[str, Any], steps: str | None) -> str:
    """The sha256, in hex, of a resolved job without its name, its figures and other fields without effect.

    Args:
        resolved: the job as plain values, as `Job.resolved` gives it.
        run: its run kind, which decides which of its fields count.
        engine: name, lanes, block and device on which the rows run.
        steps: digest of the steps that the model recommends, if the job leaves them open.
    """
    deciding = {key: resolved[key] for key in ("model", "structure", "params", "start", "numerics")}
    deciding |= {"vary": _in_order(resolved["vary"]), "run": run.hashed(resolved["run"]), "engine": engine}
    if steps is not None:
        deciding["steps"] = steps
    deciding["form"] = _HASHED_FORM
    text = json.dumps(deciding, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _in_order(vary: dict[str, Any]) -> list[Any]:
    """`vary` with its names in lists, so that the hash depends on their order."""
    ordered: list[Any] = []
    for name, value in vary.items():
        groups = value if isinstance(value, list) else [value]
        if name == "zip":
            ordered.append([name, [list(group.items()) for group in groups]])
        elif name == "sample":
            ordered.append([name, [[*group.items(), list(group["of"].items())] for group in groups]])
        else:
            ordered.append([name, value])
    return ordered
