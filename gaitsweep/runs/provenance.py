"""Provenance of a table: versions, commit and machine of each maker of its parts.

A directory is continued by the program with which it was begun.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import os
import platform
import re
import subprocess
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypedDict

from gaitsweep.contract import Model
from gaitsweep.models.traced_program import DECLARATIONS, first_difference
from gaitsweep.runs.prepare import RunContext, RunError
from gaitsweep.table import Table

PACKAGES = (
    *("gaitsweep", "jax", "jaxlib", "numpy", "scipy", "pandas", "pyarrow"),
    *("llvmlite", "cuda-core", "nvidia-cuda-nvrtc", "mujoco", "mujoco-mjx"),
)

PROGRAM = "program"  # digests of the functions and quantities of a user's model, by name
NOT_INSTALLED = "not installed"  # in place of the version of a package
EARLIER = "made_before"  # versions, machine, commit and parts of each earlier maker
_MAKER = ("versions", "machine", "git_commit")
# versions that a trace depends on
_TRACING = ("python", "gaitsweep", "jax", "jaxlib", "mujoco", "mujoco-mjx")


@functools.cache
def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the numbers."""
    python = {"python": platform.python_version()}
    return python | {package: version_of(package) for package in PACKAGES}


def version_of(package: str) -> str:
    """Return the version of an installed package."""
    try:
        described = importlib.metadata.distribution(package).read_text("METADATA") or ""
    except importlib.metadata.PackageNotFoundError:
        return NOT_INSTALLED
    # `importlib.metadata.version` reads the whole description of a package as an email
    line = re.search(r"^Version: *(.+)$", described, re.MULTILINE)
    return importlib.metadata.version(package) if line is None else line[1].strip()


class Paper(TypedDict):
    """Reference to the paper of a model: one line, and its BibTeX entry or an empty text."""

    source: str
    bibtex: str


def paper_of(model: Model | type[Model]) -> Paper | None:
    """Return the reference to a model's paper; None if the model names none."""
    source = getattr(model, "source", "").strip()  # a user's class may lack it
    entry = model.bibtex.strip()
    return {"source": source, "bibtex": entry} if source or entry else None


@functools.cache
def machine() -> str:
    """System, processor and number of cores of the machine that runs the rows or dispatches them."""
    processor = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):  # Linux, whose own name of the processor says only x86_64
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
        processor = next(named, processor)
    return f"{platform.system()} {platform.release()}, {processor}, {os.cpu_count()} cores"


@functools.cache
def git_commit() -> str | None:
    """Commit of the checkout that gaitsweep runs from, `+changes` where files differ; None outside one."""
    folder = Path(__file__).resolve().parents[1]  # of the package
    try:
        # a package installed somewhere inside another project's checkout has no commit of its own
        if Path(_git(folder, "rev-parse", "--show-toplevel")) != folder.parent:
            return None
        commit = _git(folder, "rev-parse", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--", str(folder))
    except (OSError, subprocess.SubprocessError):
        return None
    return f"{commit}+changes" if changed else commit


def _git(folder: Path, *arguments: str) -> str:
    """The output of a git command in a folder."""
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()


def continue_directory(context: RunContext, directory: Table, on_message: Callable[[str], None]) -> None:
    """Record in the manifest which program makes the next parts, and warn if another made the present ones.

    Args:
        context: the job's context.
        directory: its table.
        on_message: called with each warning, a sentence.

    Raises:
        RunError: a function of the user's model differs from the one with which the directory was begun.
    """
    manifest = directory.manifest
    for warning in check_program(context, directory.path, manifest):
        on_message(warning)
    fields: dict[str, Any] = {PROGRAM: dict(context.program) or None, "paper": paper_of(context.model)}
    missing = directory.missing_blocks()
    last_maker = {name: manifest[name] for name in _MAKER if manifest.get(name) is not None}
    if missing and last_maker:
        present = set(directory.layout.blocks) - set(missing)
        makers = _earlier_makers(manifest, present)
        difference = "; ".join(differing(last_maker))
        # parts of an unknown commit are not those of a known one, though nobody need be warned of that
        if difference or manifest.get("git_commit") != git_commit():
            known = {number for maker in makers for number in _numbers(maker["parts"])}
            makers.append({**last_maker, "parts": _ranges(present - known)})
        if difference:
            _warn_of_other_maker(directory, difference, on_message)
        fields[EARLIER] = [maker for maker in makers if maker["parts"]] or None
    if missing:
        fields |= {"versions": versions(), "machine": machine()}
        fields["git_commit"] = git_commit()
    if any(manifest.get(name) != value for name, value in fields.items()):
        directory.update_manifest(**fields)


def _earlier_makers(manifest: Mapping[str, Any], present: set[int]) -> list[dict[str, Any]]:
    """The earlier makers in a manifest, each with those of its parts that are present."""
    makers = [dict(maker) for maker in manifest.get(EARLIER, ())]
    for maker in makers:
        maker["parts"] = _ranges(set(_numbers(maker["parts"])) & present)
    return makers


def _warn_of_other_maker(directory: Table, difference: str, on_message: Callable[[str], None]) -> None:
    """Warn that rows of a table, if it has any, were made by another program or machine."""
    rows = directory.rows_done + directory.rows_open
    if not rows:
        rows = directory.manifest.get("refinement", {}).get("simulated", 0)
    if rows:
        on_message(
            f"Warning: {rows} of the {directory.layout.rows} rows in {directory.path} were made with "
            f"{difference}. The other rows may differ from theirs in the last digits; {EARLIER} in "
            "manifest.json names the parts of each."
        )


def check_program(context: RunContext, path: Path | None, manifest: Mapping[str, Any]) -> list[str]:
    """Return warnings if a model's functions are traced differently by other versions.

    Args:
        context: the job's context.
        path: the result directory, for messages.
        manifest: its manifest.

    Raises:
        RunError: they are traced differently by the same versions.
    """
    program_before = manifest.get(PROGRAM)
    if not isinstance(program_before, dict):
        return []
    changed = first_difference(program_before, context.program)
    if changed is None:
        return []
    declared = f"the {changed} of {context.job.model} are others"
    traced = f"the function {changed} of {context.job.model} computes something else"
    what = declared if changed in DECLARATIONS else traced
    if _other_versions(manifest, _TRACING) or _commits(manifest):
        return [
            f"Warning: {path} was begun with {'; '.join(differing(manifest))}, and {what}. Other "
            "versions may trace the same function differently; whether a data file or a constant has changed "
            "as well is not known."
        ]
    raise RunError(
        f"{path} holds another job's table: {what} than when it was begun. A data file, a constant or a "
        "module that the model reads has changed: restore it, or choose another directory with --out."
    )


def differing(before: Mapping[str, Any]) -> list[str]:
    """Describe how an earlier maker differs from this process."""
    differences = [*_other_versions(before, versions()), *_commits(before)]
    earlier = before.get("machine")
    if isinstance(earlier, str) and _processor(earlier) != _processor(machine()):
        differences.append(f"the processor {_processor(earlier)} (here {_processor(machine())})")
    return differences


def _other_versions(before: Mapping[str, Any], packages: Iterable[str]) -> list[str]:
    """Describe the versions of packages that are known of an earlier maker and differ."""
    versions_before = before.get("versions", {})
    return [
        f"{name} {versions_before[name]} (here {versions()[name]})"
        for name in packages
        if versions_before.get(name, versions()[name]) != versions()[name]
    ]


def _commits(before: Mapping[str, Any]) -> list[str]:
    """Describe the commits of gaitsweep if they differ and both are known."""
    commit, this_commit = before.get("git_commit"), git_commit()
    if not isinstance(commit, str) or this_commit is None or commit == this_commit:
        return []
    return [f"commit {commit[:12]} of gaitsweep (here {this_commit[:12]})"]


def _processor(machine: str) -> str:
    """Return the processor from a text of `machine`; system and core count affect no digit."""
    return machine.partition(", ")[2].rpartition(", ")[0]


def _ranges(numbers: Iterable[int]) -> list[list[int]]:
    """Group numbers into pairs of the first and the last of each consecutive run."""
    ranges: list[list[int]] = []
    for number in sorted(numbers):
        if ranges and ranges[-1][1] == number - 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    return ranges


def _numbers(ranges: Iterable[Iterable[int]]) -> Iterable[int]:
    """The numbers in pairs of the first and the last."""
    for first, last in ranges:
        yield from range(first, last + 1)
