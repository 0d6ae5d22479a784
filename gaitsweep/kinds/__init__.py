"""Run kinds: the tasks that a job can give to each of its rows. A kind is one class.

`run_kind` is their interface, and `columns` declares the columns of their tables. The file of a kind has its
name, but `trace_and_ramp` has `fixed_time`, `return_map`, `ramp` and `trace`, which wait for no gait. The
kinds that follow fixed points share `fixed_points`, and `atlas_block` computes the table of an atlas.
`RUN_KINDS` lists the kinds. `register` adds one from another package before its jobs are read; it is usable
as a decorator:

    @gaitsweep.kinds.register
    class Count(RunKind): ...
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.extension import import_all
from gaitsweep.kinds.atlas import Atlas
from gaitsweep.kinds.continuation import Continuation
from gaitsweep.kinds.perturb import Perturb
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.kinds.settle import Settle
from gaitsweep.kinds.staircase import Staircase
from gaitsweep.kinds.trace_and_ramp import FixedTime, Ramp, ReturnMap, Trace
from gaitsweep.schema.strict_model import Registry

__all__ = ["RUN_KINDS", "RunKind", "kind_written", "parameter_written", "register", "unregister"]

RUN_KINDS: Registry[RunKind] = Registry(
    "run", [Settle, FixedTime, Trace, Ramp, ReturnMap, Staircase, Continuation, Atlas, Perturb]
)
register = RUN_KINDS.register
unregister = RUN_KINDS.unregister
import_all("run_kinds")


def parameter_written(run: Any) -> object:
    """The parameter that a run moves, as written in a job that is not checked yet, or None."""
    kind = kind_written(run)
    moves = kind is not None and {"parameter", "path"} <= kind.model_fields.keys()
    return run.get("parameter") if moves else None


def kind_written(run: Any) -> type[RunKind] | None:
    """The kind of a run as written in a job that is not checked yet, or None."""
    name = run.get("kind") if isinstance(run, Mapping) else None
    return RUN_KINDS.get(name) if isinstance(name, str) else None
