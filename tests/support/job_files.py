"""Job files of a toy model, and the messages with which bad ones are refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gaitsweep.job import JobError, load_job

GOOD = """\
name: quick
model: toy_model:Toy
params: {mass: 2}
vary:
  launch_1: {linspace: [1, 2, 3]}
run: {kind: settle}
numerics: {dt: 2e-3}
engine: {block: 64}
figures:
  - {kind: basin, x: launch_1, y: launch_1_end}
"""


TRACE = "{kind: trace, duration: 10, every: 0.1}"


RAMP = "{kind: ramp, parameter: stiffness, path: [4, 9], rate: 0.1}"


MAP = "{kind: return_map, crossings: 5}"


# What pydantic, PyYAML and Python say themselves, none of which may reach the user.
FOREIGN = re.compile(
    r"pydantic|Input should|Extra inputs|Field required|validation error|yaml\.org|scanner|Traceback|NoneType"
    r"|expected <|\bstr\b|\bdict\b|(?<!!)\bint\b|input_value|errors\.|<class"
)


def refused(path: Path, *overrides: str) -> str:
    """The message with which a file is refused, checked to be sentences of ours, a line each."""
    with pytest.raises(JobError) as error:
        load_job(path, overrides)
    message = str(error.value)
    assert not FOREIGN.search(message), message
    for line in message.split("\n"):
        assert line.endswith((".", "?")), line
        assert len(line) < 600, line
    return message


def written(folder: Path, text: str | bytes, name: str = "bad.yaml") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path
