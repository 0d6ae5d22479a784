"""The hash of a job: what decides its numbers, and nothing else."""

from __future__ import annotations

import copy
import functools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitsweep.job import Job
from tests.support.toy_jobs import BASE, toy

PINNED_HASH = "371eb7c151e5829939433e9b77d389a0c593cb9fa5b5bb78c225b27fe76654f1"


def _shuffled(value: Any, data: st.DataObject) -> Any:
    if isinstance(value, dict):
        keys = data.draw(st.permutations(list(value)))
        return {key: _shuffled(value[key], data) if key != "vary" else value[key] for key in keys}
    return value


DECIDING = {
    **BASE,
    "structure": {"N": 2},
    "params": {"mass": 2, "stiffness": 9.0, "preload": "mass/4"},
    "start": {"launch_1": 1.5},
    "vary": {"launch_2": {"linspace": [1, 2, 5]}, "restitution": {"random": [0, 0.5, 3], "seed": 2}},
    "run": {"kind": "settle", "max_cycles": 50, "tolerance": 1e-4},
    "numerics": {"dt": 1e-3, "event_tolerance": 1e-11},
    "engine": {"block": 64, "lanes": 8},
}


@pytest.mark.slow
@given(st.data())
def test_hash_does_not_see_the_order_of_keys(data: st.DataObject) -> None:
    assert Job(**_shuffled(DECIDING, data)).hash() == _hash_in_order()


@functools.cache
def _hash_in_order() -> str:
    return Job(**DECIDING).hash()


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("structure.N", 3),
        ("params.mass", 2.0000000000000004),
        ("params.preload", "mass/5"),
        ("params.kick", 0.1),
        ("start.launch_1", 1.25),
        ("vary.launch_2.linspace", [1, 2, 6]),
        ("vary.launch_2.linspace", [1, 2.5, 5]),
        ("vary.launch_2.at", "centre"),
        ("vary.restitution.seed", 3),
        ("vary.restitution", {"sobol": [0, 0.5, 3], "seed": 2}),
        ("vary.ceiling", [10]),
        ("run.max_cycles", 51),
        ("run.tolerance", 2e-4),
        ("run.max_time", 1e3),
        ("run", {"kind": "return_map", "crossings": 5}),
        ("numerics.dt", 1.5e-3),
        ("numerics.precision", "float32"),
        ("numerics.event_tolerance", 1e-10),
        ("engine.block", 65),
        ("engine.lanes", 9),
        ("engine.contraction", False),
    ],
)
def test_the_hash_depends_on_everything_that_determines_results(path: str, value: Any) -> None:
    changed = copy.deepcopy(DECIDING)
    *outer, last = path.split(".")
    inside: Any = changed
    for key in outer:
        inside = inside[key]
    inside[last] = value
    assert Job(**changed).hash() != Job(**DECIDING).hash()


def test_hash_sees_neither_name_nor_figures() -> None:
    plain = toy(vary={"mass": [1, 2]})
    figure = {"kind": "basin", "x": "mass", "y": "launch_1_end"}
    assert toy(name="other", vary={"mass": [1, 2]}, figures=[figure]).hash() == plain.hash()
    other = toy(vary={"mass": {"values": [1.0, "4/2"]}}, engine={"name": "xla", "devices": 2})
    assert other.hash() == plain.hash(engine="xla")
    assert plain.hash(device="gpu") != plain.hash()
    assert plain.hash(lanes=256) != plain.hash(lanes=512)
    # as before there was a choice: directories of older runs can be resumed
    assert toy(vary={"mass": [1, 2]}, engine={"contraction": True}).hash() == plain.hash()


def test_hash_sees_the_order_of_the_axes() -> None:
    assert toy(vary={"mass": [1], "preload": [2]}).hash() != toy(vary={"preload": [2], "mass": [1]}).hash()


def test_hash_is_pinned() -> None:
    """The same in every version of Python: a change of it must be meant (`_HASHED_FORM`)."""
    assert Job(**DECIDING).hash() == PINNED_HASH
