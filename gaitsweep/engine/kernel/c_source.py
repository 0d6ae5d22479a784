"""Structures and functions of C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gaitsweep.engine.kernel.operations import Kind
from gaitsweep.engine.kernel.source import C


def structure(name: str, members: Mapping[str, Kind]) -> str:
    """The definition of a structure with these members; one without any has a member that is not used."""
    lines = [f"    {C.types[kind]} {member};" for member, kind in members.items()] or ["    double none;"]
    return "\n".join([f"struct {name} {{", *lines, "};\n"])


def function(head: str, lines: Sequence[str]) -> str:
    """The definition of a function from its head, without braces, and the lines of its body."""
    return "\n".join([f"{head} {{", *(f"    {line}" for line in lines), "}\n"])
