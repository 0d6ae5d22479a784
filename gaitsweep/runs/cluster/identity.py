"""Identity of a process that computes the same bits: program, packages, processor and engine."""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import platform
from collections.abc import Mapping
from pathlib import Path

from gaitsweep.errors import UserError
from gaitsweep.own_modules import installed
from gaitsweep.runs.prepare import RunContext
from gaitsweep.runs.provenance import versions

Identity = Mapping[str, str]
MODEL_FILE = ""  # in place of a module's name, where a model is a file and not a module


class WorkerUnfit(UserError):
    """A worker cannot compute this job's blocks; the message is the reason, without the worker's name.

    `address` is the worker's address, once known.
    """

    def __init__(self, why: str, address: str = "") -> None:
        self.address = address
        super().__init__(why)

    def __reduce__(self) -> tuple[type[WorkerUnfit], tuple[str, str]]:
        return WorkerUnfit, (str(self), self.address)


def identity_of(context: RunContext) -> Identity:
    """Return the identity of this process for a job."""
    return {
        **versions(),
        "gaitsweep's source": _source_digest()[:12],
        "the processor": _processor(),
        "the platform": context.spec.devices[0].platform,
        "the engine": context.engine,
        "the lanes": str(context.spec.lanes),
        "the model's program": hashlib.sha256(json.dumps(dict(context.program)).encode()).hexdigest()[:12],
        "the job's hash": context.job_hash[:12],
    }


def difference(worker: Identity, client: Identity) -> str | None:
    """Describe how a worker differs from the client; return None if it does not."""
    differences = [
        f"{name} is {worker.get(name, 'unknown')} there and {value} here"
        for name, value in client.items()
        if worker.get(name) != value
    ]
    if len(differences) > 1:  # the hash follows from the others
        differences = [text for text in differences if not text.startswith("the job's hash")]
    elif differences and differences[0].startswith("the job's hash"):
        differences = [f"{differences[0]} (the files of its model differ)"]
    return "; ".join(differences) or None


def own_modules(context: RunContext) -> tuple[tuple[str, str], ...]:
    """Return the user's modules that a job needs, with the folders from which they are imported.

    A model file has the name `MODEL_FILE`, and the folder from which its path in the job begins.
    """
    folders: dict[str, str] = {}
    for own_class in (type(context.model.original), type(context.job.run)):
        model_file = getattr(own_class, "model_file", None)
        if model_file is not None:
            bases = (path for path in model_file.parents if (path / context.job.model).is_file())
            folders[MODEL_FILE] = str(next(bases, model_file.parent))
            continue
        module = inspect.getmodule(own_class)
        file = getattr(module, "__file__", None)
        if module is None or file is None or module.__name__.startswith("gaitsweep.") or installed(module):
            continue
        levels = len(module.__name__.split(".")) - (0 if Path(file).name == "__init__.py" else 1)
        folders[module.__name__] = str(Path(file).resolve().parents[levels])
    return tuple(folders.items())


@functools.cache
def _source_digest() -> str:
    """The sha256, in hex, of gaitsweep's source files."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.py")):
        digest.update(f"{file.relative_to(root)}\n".encode() + file.read_bytes())
    return digest.hexdigest()


def _processor() -> str:
    """The kind of processor, as far as it decides how numbers are rounded."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    # a fused product and sum rounds once
    return f"{platform.machine()} {'with' if features.get('fma') else 'without'} fused multiply-add"
