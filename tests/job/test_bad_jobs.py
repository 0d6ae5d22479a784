"""Invalid jobs: each is refused with its place, the allowed values or the near miss."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from gaitsweep.errors import ArgumentError
from gaitsweep.job import Job, JobError, load_job
from gaitsweep.schema.numbers import InvalidValue, read_real, read_whole
from tests.support.job_files import GOOD, MAP, RAMP, TRACE, refused, written


def test_a_precision_in_which_the_model_is_not_right(tmp_path: Path) -> None:
    text = GOOD.replace("toy_model:Toy", "multilegged").replace("{mass: 2}", "{m: 1}")
    text = text.replace("launch_1_end", "psi_1_end").replace("launch_1", "psi_1")
    message = refused(written(tmp_path, text), "numerics.precision=float32", "start={psi_2: 1, psi_3: 1}")
    assert "numerics.precision is float32" in message


def test_a_second_parameter_that_varies(tmp_path: Path) -> None:
    run = (
        "{kind: atlas, parameter: preload, path: [1, 2], ranges: {launch_1: [1, 2]}, second: {mass: [1, 3]}}"
    )
    text = GOOD.replace("params: {mass: 2}", "figures: []").replace("  launch_1: {lin", "  mass: {lin")
    text = text.replace("{kind: settle}", run).partition("figures:\n")[0]
    message = refused(written(tmp_path, text))
    assert "line 5: vary.mass varies, but run.second.mass moves it" in message


def test_the_good_job_is_good(tmp_path: Path) -> None:
    load_job(written(tmp_path, GOOD))


def test_fields_are_not_paths() -> None:
    with pytest.raises(ArgumentError, match=r"path is a dict, .* path of a YAML file.*Job\(\*\*fields\)"):
        load_job({"name": "x"})  # pyright: ignore[reportArgumentType]


# One line of the good job replaced: (line, what stands there instead, words that the message must have)
LINES: list[tuple[int, str, list[str]]] = [
    # names, fields, kinds
    (
        1,
        "nmae: quick",
        ["line 1", "nmae is not a field of a job", "did you mean name?", "Allowed: name, model,"],
    ),
    (3, "mass: 2", ["line 3", "mass is a parameter of toy", "under params", "params.mass=VALUE"]),
    (3, "launch_1: 2", ["launch_1 is a start value of toy", "under start", "start.launch_1=VALUE"]),
    (1, "name: 2021", ["line 1", "name is 2021", "put it in quotes"]),
    (1, "name: ''", ["line 1", "name is empty"]),
    (1, "name: ../up", ["line 1", 'name is "../up"', "letters, digits"]),
    (1, "", ["name is missing"]),
    (1, "name: [a]", ["line 1", "name is a list", "text"]),
    (
        2,
        "model: multileged",
        ["line 2", "model is multileged", "did you mean multilegged?", "module:attribute"],
    ),
    (2, "model: toy_model:Toi", ["line 2", "toy_model has no Toi", "did you mean Toy?"]),
    (2, "model: toy_modell:Toy", ["line 2", "toy_modell cannot be imported: no module of that name"]),
    (2, "model: tests/toy_model.py:Toy", ["line 2", "write toy_model:Toy."]),
    (2, "model: toy_model:Params", ["line 2", "is not a model", "HybridModel or SteppedModel"]),
    (2, "model: toy_model:flight_time", ["line 2", "is not a model"]),
    (2, "model: toy_model:HybridModel", ["line 2", "not a complete model", "flow"]),
    (2, "model: 'toy model:Toy'", ["line 2", "not a valid name", "package.module:attribute"]),
    (2, "model: 7", ["line 2", "model is 7", "text"]),
    (2, "", ["model is missing"]),
    # parameters
    (
        3,
        "params: {mas: 2}",
        ["line 3", "params.mas is not a parameter of toy", "did you mean mass?", "stiffness"],
    ),
    (3, "params: {launch_1: 2}", ["line 3", "params.launch_1", "start value of toy", "write it under start"]),
    (3, "start: {mass: 2}", ["line 3", "start.mass is a parameter of toy", "write it under params"]),
    (3, "start: {N: 2}", ["line 3", "start.N", "under structure or params"]),
    (3, "start: {launch_1: 2}", ["line 5", "vary.launch_1 varies, but start.launch_1 fixes it"]),
    (3, "params: 3", ["line 3", "params is 3", "name: number"]),
    (3, "params: [mass, 2]", ["line 3", "params is a list (", "name: number"]),
    (3, "params: {mass: -2}", ["line 3", "params.mass is -2", "must be above 0 (mass, in kg)"]),
    (3, "params: {mass: 1-2}", ["line 3", "params.mass is -1", "must be above 0"]),
    (3, "params: {restitution: 2}", ["line 3", "params.restitution is 2", "from 0 to 0.99"]),
    (
        3,
        "params: {kicking: yes}",
        ["line 3", 'params.kicking is "yes"', "true, false or a number from 0 to 1"],
    ),
    (3, "params: {mass: true}", ["line 3", "params.mass is true", "a number"]),
    (3, "params: {mass: }", ["line 3", "params.mass is empty"]),
    (3, "params: {mass: [1, 2]}", ["line 3", "params.mass is a list (1, 2)", "one number", "under vary"]),
    (3, "params: {mass: .nan}", ["line 3", "params.mass", "a finite number"]),
    (3, "params: {mass: inf}", ["line 3", "params.mass", "a finite number"]),
    (3, "params: {mass: 1e400}", ["line 3", "params.mass", "finite number"]),
    (3, "params: {mass: 1:30}", ["line 3", 'params.mass is "1:30"', "base 60"]),
    (3, "params: {mass: 010}", ["line 3", 'params.mass is "010"', "base 8", "without the leading zero"]),
    (3, "params: {mass: 2020-11-12}", ["line 3", "params.mass", "is a date, not a number"]),
    (3, "params: {mass: '1,5'}", ["line 3", "params.mass", "decimal point", "dot"]),
    (3, "params: {mass: 2 kg}", ["line 3", "params.mass is not a number", "if kg is a unit, 2 alone"]),
    (3, "params: {mass: 2pi}", ["line 3", "params.mass", "2*pi"]),
    (3, "params: {mass: 2*stifness}", ["line 3", "params.mass uses stifness", "did you mean stiffness?"]),
    (
        3,
        "params: {mass: 2*launch_1}",
        ["line 3", "params.mass uses launch_1", "start value", "Allowed: mass"],
    ),
    (3, "params: {mass: stiffness, stiffness: mass}", ["line 3", "depends on itself", "mass -> stiffness"]),
    (3, "params: {mass: 1/(stiffness-4)}", ["line 3", "params.mass has no value", "divides by zero"]),
    (3, "params: {mass: __import__('os')}", ["line 3", "params.mass", "__import__ is not a known function"]),
    (3, "params: {mass: '().__class__'}", ["line 3", "params.mass", "a dot after a name is not allowed"]),
    # structure and config
    (3, "structure: {N: 0}", ["line 3", "structure.N is 0", "whole number from 1 to 8"]),
    (3, "structure: {N: 1.5}", ["line 3", "structure.N is 1.5", "whole number"]),
    (3, "structure: N=2", ["line 3", 'structure is "N=2"', "name: value"]),
    (3, "structure: [2]", ["line 3", "structure is a list (2)", "name: value"]),
    (3, "structure: {M: 2}", ["line 3", "structure.M is not part of the structure", "Allowed: N"]),
    (3, "params: {N: 9}", ["line 3", "params.N is 9", "from 1 to 8"]),
    (3, "structure: {N: 2}\nparams: {N: 3}", ["line 4", "params.N is 3", "structure.N is 2"]),
    (3, "config: nothing.yaml", ["line 3", "config names", "nothing.yaml, which does not exist"]),
    (3, "config: .", ["line 3", "config names", "is a directory"]),
    (3, "config: 3", ["line 3", "config is 3", "builtin:NAME"]),
    # axes
    (5, "  launch_3: [1, 2]", ["line 5", "vary.launch_3", "did you mean launch_1?", "mass"]),
    (5, "  N: [1, 2]", ["line 5", "vary.N", "cannot vary", "under structure or params"]),
    (5, "  mass: [1, 2]", ["line 5", "vary.mass varies, but params.mass fixes it"]),
    (5, "  launch_1: 3", ["line 5", "vary.launch_1 is 3", "values, linspace, logspace, random, sobol"]),
    (5, "  launch_1: []", ["line 5", "vary.launch_1.values has 0 items", "at least 1"]),
    (5, "  launch_1: {}", ["line 5", "vary.launch_1 is empty", "linspace"]),
    (5, "  launch_1:", ["line 5", "vary.launch_1 is empty", "linspace"]),
    (5, "  launch_1: {at: ends}", ["line 5", "vary.launch_1 has no points", "Allowed: values, linspace"]),
    (5, "  launch_1: {linspcae: [1, 2, 3]}", ["line 5", "vary.launch_1.linspcae", "did you mean linspace?"]),
    (
        5,
        "  launch_1: {linspace: [1, 2]}",
        ["line 5", "vary.launch_1.linspace", "[first, last, number of points]"],
    ),
    (
        5,
        "  launch_1: {linspace: [1, 2, 0]}",
        ["line 5", "vary.launch_1.linspace[2] is 0", "whole number from 1"],
    ),
    (5, "  launch_1: {linspace: [1, 2, -3]}", ["line 5", "linspace[2] is -3", "whole number from 1"]),
    (5, "  launch_1: {linspace: [1, 2, 2.5]}", ["line 5", "linspace[2] is 2.5", "whole number"]),
    (5, "  launch_1: {linspace: [1, .inf, 3]}", ["line 5", "linspace[1]", "finite number"]),
    (5, "  launch_1: {linspace: [1, x, 3]}", ["line 5", "vary.launch_1 uses x", "Allowed: mass"]),
    (5, "  launch_1: {linspace: [0, 2, 3]}", ["line 5", "launch_1 is 0 in row 0", "above 0"]),
    (
        5,
        "  launch_1: {linspace: [1, 2, 3], at: center}",
        ["line 5", "at", "did you mean centre?", "ends, centre"],
    ),
    (
        5,
        "  launch_1: {linspace: [1, 2, 3], seed: 1}",
        ["line 5", "seed is not a field of an axis (linspace)"],
    ),
    (
        5,
        "  launch_1: {linspace: [1, 2, 3], values: [1]}",
        ["line 5", "has values and linspace", "one of them"],
    ),
    (5, "  launch_1: {logspace: [0, 2, 3]}", ["line 5", "vary.launch_1 has no value", "above 0"]),
    (
        5,
        "  launch_1: {random: [2, 1, 3]}",
        ["line 5", "launch_1.random goes from 2 to 1", "low end"],
    ),
    (5, "  launch_1: {random: [1, 2, 3], seed: -1}", ["line 5", "seed is -1", "from 0"]),
    (5, "  launch_1: {sobol: [1, 2, 3], sead: 1}", ["line 5", "sead", "did you mean seed?"]),
    (5, "  launch_1: [1, two]", ["line 5", "launch_1 uses two", "Allowed: mass"]),
    (5, "  launch_1: [1, yes]", ["line 5", 'values[1] is "yes"', "a number"]),
    (5, "  launch_1: [1, 1:30]", ["line 5", 'values[1] is "1:30"', "base 60"]),
    (5, "  launch_1: [1, 2, -1, 3]", ["line 5", "vary.launch_1 is -1 in row 2", "above 0"]),
    (5, "  launch_1: [1, preload-0.5]", ["line 5", "vary.launch_1 is 0 in row 1", "above 0"]),
    (5, "  preload: [1, 0.5]\n  launch_1: [1, preload-0.5]", ["line 6", "vary.launch_1 is 0 in row 3"]),
    (5, "  launch_1: [launch_1]", ["line 5", "depends on itself", "launch_1 -> launch_1"]),
    (5, "  zip: {launch_1: [1, 2], preload: [1]}", ["line 5", "vary.zip", "launch_1 has 2, preload has 1"]),
    (5, "  zip: {launch_1: [1, 2]}\n  launch_1: [1]", ["line 6", "vary.launch_1", "vary.zip.launch_1"]),
    (5, "  zip: [{launch_1: [1, 2]}, {launch_1: [1]}]", ["line 5", "also varied by vary.zip[0].launch_1"]),
    (5, "  zip: [1, 2]", ["line 5", "vary.zip[0] is 1", "equal length"]),
    (5, "  sample: {of: {launch_1: [1, 2]}}", ["line 5", "vary.sample.n is missing: number of points"]),
    (5, "  sample: {n: 3, of: {}}", ["line 5", "vary.sample.of has 0 items"]),
    (5, "  sample: {n: 3, of: {launch_1: 3}}", ["line 5", "vary.sample.of.launch_1 is 3", "[low, high]"]),
    (5, "  sample: {n: 3, of: {launch_1: [3, 1]}}", ["line 5", "sample.of.launch_1 goes from 3 to 1"]),
    (5, "  sample: {n: 3, of: {lunch_1: [1, 3]}}", ["line 5", "did you mean launch_1?"]),
    (5, "  sample: {n: 3, method: sobel, of: {launch_1: [1, 3]}}", ["method", "did you mean sobol?"]),
    (5, "  sample: 3", ["line 5", "vary.sample is 3", "Allowed: n, seed, method, of"]),
    (5, "  sample: []", ["line 5", "vary.sample is an empty list"]),
    (5, "  zip: []", ["line 5", "vary.zip is an empty list"]),
    (5, "  preload: {linspace: [-1e308, 1e308, 3]}", ["line 5", "goes from -1e+308", "1.8e308 apart"]),
    (5, "  preload: {random: [-1e308, 1e308, 3]}", ["line 5", "goes from -1e+308", "1.8e308 apart"]),
    (4, "vary: [launch_1]\nx:", ["line 4", "vary is a list", "name: axis"]),
    (
        5,
        "  launch_1: {linspace: [1, 2, 10000]}\n  preload: {linspace: [1, 2, 100001]}",
        ["line 4", "1000010000 rows", "at most 1000000000"],
    ),
    # run
    (
        6,
        "run: {kind: setle}",
        ["line 6", "run.kind", "did you mean settle?", "settle, fixed_time, trace, ramp, return_map"],
    ),
    (6, "run: {max_cycles: 3}", ["line 6", "run.kind is missing", "Allowed: settle"]),
    (6, "run: settle", ["line 6", 'run is "settle"', "kind", "Allowed: "]),
    (
        6,
        "run:",
        [
            "run is missing",
            "settle, fixed_time, trace, ramp, return_map, staircase, continuation, atlas or perturb",
        ],
    ),
    (
        6,
        "run: {kind: settle, max_cycels: 3}",
        [
            "line 6: run.max_cycels is not a field of run (settle); did you mean max_cycles? Allowed: kind, "
            "max_cycles, tolerance, max_time, max_period, exponents, states, refine, over, coarse."
        ],
    ),
    (6, "run: {kind: settle, rate: 2}", ["run.rate is not a field", "it belongs under run (trace, ramp)"]),
    (6, "run: {kind: settle, verify: 3}", ["run.verify is not a field", "it belongs at the top of the job"]),
    (
        6,
        "run: {kind: settle}\nstyle: {shares: false}",
        ["line 7", "style.shares is not a field of a style: it belongs in an entry of figures (basin"],
    ),
    (6, "run: {kind: settle, max_cycles: 0}", ["line 6", "run.max_cycles is 0", "whole number from 1"]),
    (6, "run: {kind: settle, max_cycles: many}", ["line 6", 'run.max_cycles is "many"', "unknown"]),
    (6, "run: {kind: settle, tolerance: 0}", ["line 6", "run.tolerance is 0", "above 0"]),
    (6, "run: {kind: settle, tolerance: -1e-3}", ["line 6", "run.tolerance is -0.001", "above 0"]),
    (6, "run: {kind: settle, max_time: launch_1}", ["line 6", "run.max_time", "launch_1 varies in this job"]),
    (
        6,
        "run: {kind: trace, duration: 3}",
        ["line 6", "run.every is missing: interval between samples, in s"],
    ),
    (6, "run: {kind: trace, duration: 1, every: 2}", ["line 6", "run.every is 2 s", "run.duration, 1 s"]),
    (6, "run: {kind: trace, duration: 1, every: 1e-9}", ["line 6", "run.every", "1e+09 samples"]),
    (
        6,
        "run: {kind: ramp, parameter: stifness, path: [1, 2], rate: 1}",
        ["run.parameter", "mean stiffness?"],
    ),
    (6, "run: {kind: ramp, parameter: launch_1, path: [1, 2], rate: 1}", ["run.parameter", "start value"]),
    (
        6,
        "run: {kind: ramp, parameter: mass, path: [1, 2], rate: 1}",
        ["line 3", "params.mass is fixed", "run.parameter moves it"],
    ),
    (6, "run: {kind: ramp, parameter: preload, path: [1], rate: 1}", ["line 6", "run.path has 1 items"]),
    (6, "run: {kind: ramp, parameter: preload, path: [1, 0], rate: 1}", ["run.path[1] is 0", "above 0"]),
    (6, "run: {kind: ramp, parameter: preload, path: [1, 1], rate: 1}", ["run.path[1] is 1, like the value"]),
    (
        6,
        "run: {kind: trace, duration: 1, every: 0.1, parameter: preload, path: [1, 2, 2], rate: 1}",
        ["run.path[2] is 2, like the value"],
    ),
    (
        6,
        "run: {kind: continuation, parameter: preload, path: [1, 2], crossing: yes}",
        ["line 6", 'run.crossing is "yes", but must be true or false'],
    ),
    (
        6,
        "run: {kind: atlas, parameter: preload, path: [1, 2], ranges: {launch_1: [1, 2]}, "
        "second: {stiffness: [1, 2]}}",
        ["line 6", "run.second.stiffness is from 1 to 2, but stiffness begins at 4"],
    ),
    (
        6,
        "run: {kind: continuation, parameter: preload, path: [1, 2], stationary: 1}",
        ["line 6", "run.stationary is 1, but must be true or false"],
    ),
    (
        6,
        "run: {kind: continuation, parameter: preload, path: [1, 2], without: [clock]}",
        ["line 6", "run.without names variables that need not rest", "run.stationary"],
    ),
    (
        6,
        "run: {kind: ramp, parameter: preload, path: 3, rate: 1}",
        ["line 6", "run.path is 3", "a list in brackets"],
    ),
    (
        6,
        "run: {kind: ramp, parameter: preload, path: [1, 2], rate: 0}",
        ["line 6", "run.rate is 0", "above 0"],
    ),
    (6, "run: {kind: return_map, crossings: 0}", ["line 6", "run.crossings is 0", "whole number"]),
    # numerics and engine
    (7, "numerics: {dt: 0}", ["line 7", "numerics.dt is 0", "above 0"]),
    (7, "numerics: {dt: small}", ["line 7", "numerics.dt", "small is unknown"]),
    (7, "numerics: {dT: 1e-3}", ["line 7", "numerics.dT", "did you mean dt?"]),
    (
        7,
        "numerics: {method: euler}",
        ["line 7", "numerics.method", "Allowed: auto, tsit5, taylor, rodas5p, rk4"],
    ),
    (
        7,
        "numerics: {method: propagator6}",
        ["line 7", "linear in the state", "Allowed: tsit5, taylor, rodas5p, rk4."],
    ),
    (
        7,
        "numerics: {method: semi_implicit}",
        ["line 7", "toy does not have", "Allowed: tsit5, taylor, rodas5p, rk4."],
    ),
    (7, "numerics: {precision: float16}", ["line 7", "numerics.precision", "Allowed: float64, float32"]),
    (
        7,
        "numerics: {dt: 2e-3, event_tolerance: 1}",
        ["line 7", "numerics.event_tolerance is 1,", "at most 0.001 of a period"],
    ),
    (7, "numerics: {dt: 32}", ["line 7", "numerics.dt is 32 s, too long for", "step of tsit5", "0.2776 s"]),
    (7, "numerics: {method: rk4, rtol: 1e-3}", ["line 7", "numerics.rtol", "rk4"]),
    (7, "numerics: 3", ["line 7", "numerics is 3", "Allowed: method, dt"]),
    (8, "engine: {contraction: 1}", ["line 8", "engine.contraction is 1", "true or false"]),
    (8, "engine: {name: cuda}", ["line 8", 'engine.name is "cuda"', "Allowed: auto, xla, kernel"]),
    (8, "engine: {block: 0}", ["line 8", "engine.block is 0", "whole number"]),
    (8, "engine: {lanes: 2.5}", ["line 8", "engine.lanes is 2.5", "whole number"]),
    (8, "engine: {gpus: 1}", ["line 8", "engine.gpus is not a field", "devices"]),
    (8, "engine: xla", ["line 8", "engine", "Allowed: name, lanes, block, devices"]),
    # figures
    (10, "  - {kind: bassin, x: launch_1, y: mass}", ["line 10", "figures[0].kind", "did you mean basin?"]),
    (10, "  - {x: launch_1}", ["line 10", "figures[0].kind is missing", "solution_set"]),
    (10, "  - basin", ["line 10", 'figures[0] is "basin"', "kind", "Allowed: "]),
    (10, "  - {kind: basin, x: launch_1}", ["line 10", "figures[0].y is missing"]),
    (
        10,
        "  - {kind: basin, x: launch_1, y: mass}",
        ["line 10", "figures[0].y is mass", "not a column", "launch_1"],
    ),
    (10, "  - {kind: basin, x: launch_1, y: launch_1_ned}", ["line 10", "did you mean launch_1_end?"]),
    (10, "  - {kind: basin, x: launch_1, y: 3}", ["line 10", "figures[0].y is 3", "text"]),
    (
        10,
        "  - {kind: cycles, y: [launch_1]}",
        ["line 10", "cycles", "return_map or ramp", "settle"],
    ),
    (
        10,
        "  - {kind: solution_set, axes: [launch_1, launch_1]}",
        ["line 10", "axes has 2 items", "at least 3"],
    ),
    (
        10,
        "  - {kind: solution_set, axes: [launch_1, a, b]}",
        ["figures[0].axes[1] is a", "not an observable"],
    ),
    (
        10,
        "  - {kind: solution_set, axes: [launch_1, launch_1, launch_1], theory: 1}",
        ["line 10", "theory is 1", "true or false"],
    ),
    (
        10,
        "  - {kind: solution_set, axes: [launch_1, launch_1, launch_1], points: {a: [1, 2]}}",
        ["line 10", "points.a has 2 items", "at least 3"],
    ),
    (
        10,
        "  - {kind: basin, x: launch_1, y: row}\n  - {kind: basin, x: launch_1, y: row}",
        ["line 11", "figures[1]", "figures[0]"],
    ),
    (9, "figures: basin\nx:", ["line 9", 'figures is "basin"', "a list in brackets"]),
]


@pytest.mark.parametrize(("line", "text", "words"), LINES, ids=[text.strip()[:60] for _, text, _ in LINES])
def test_a_line_that_is_wrong(tmp_path: Path, line: int, text: str, words: list[str]) -> None:
    lines: list[str] = [*GOOD.splitlines()]
    lines[line - 1] = text
    message = refused(written(tmp_path, "\n".join(lines) + "\n"))
    assert "bad.yaml" in message
    for word in words:
        assert word in message


RUNS = [
    (TRACE, "{kind: footprints, panels: rwo}", ["figures[0].panels is rwo", "did you mean row?"]),
    (TRACE, "{kind: basin, x: launch_1, y: row}", ["basin", "settle or fixed_time", "trace"]),
    (MAP, "{kind: cycles, y: [lunch_1]}", ["figures[0].y[0] is lunch_1", "did you mean launch_1?"]),
    (MAP, "{kind: cycles, y: [launch_1], x: pass}", ["figures[0].x is pass", "not a column"]),
    (MAP, "{kind: cycles, y: []}", ["figures[0].y has 0 items"]),
    (RAMP, "{kind: cycles, y: [launch_1], hue: cycles}", ["figures[0].hue is cycles", "stiffness"]),
]


@pytest.mark.parametrize(("run", "figure", "words"), RUNS)
def test_a_figure_of_another_run(tmp_path: Path, run: str, figure: str, words: list[str]) -> None:
    lines: list[str] = [*GOOD.splitlines()]
    lines[5], lines[9] = f"run: {run}", f"  - {figure}"
    message = refused(written(tmp_path, "\n".join(lines)))
    assert "line 10" in message
    for word in words:
        assert word in message


FILES: list[tuple[str | bytes, list[str]]] = [
    ("", ["is empty", "name: ..."]),
    ("\n# nothing but a comment\n", ["is empty"]),
    ("- a\n- b\n", ["line 1", "holds a list (", "mapping"]),
    ("quick\n", ["line 1", "holds", "mapping"]),
    ("3\n", ["line 1", "holds 3", "mapping"]),
    ("name: a\n\tmodel: b\n", ["line 2", "tab"]),
    ("name: a: b\n", ["line 1", "a colon"]),
    ("name: a\nvary: {mass: [1, 2}\n", ["line 2", "not closed"]),
    ("name: a\nvary: {mass: [1, 2]\n", ["not closed"]),
    ("name: 'a\nmodel: b\n", ["closing quote"]),
    ("name: a\n model: b\n", ["line 2"]),
    ("name: a\nmodel\nrun: {}\n", ["line 3", "a colon is missing"]),
    ("name: @a\n", ["line 1", "put the text in quotes"]),
    ("name: *missing\n", ["line 1", "alias", "anchor"]),
    ("name: a\n---\nname: b\n", ["line 2", "a second document"]),
    ("name: a\nmodel: b\nname: c\n", ["line 3", "name is written twice, first in line 1"]),
    ("name: a\nparams:\n  mass: 1\n  mass: 3\n", ["line 4", "params.mass is written twice, first in", "3"]),
    ("name: a\nparams: {1: 2}\n", ["line 2", "params has the key 1", "a key must be text"]),
    ("name: a\nparams: {[1]: 2}\n", ["line 2", "a key must be text"]),
    ("name: a\n? \n: 3\n", ["line 2", "a key must be text"]),
    ("name: !!python/object/apply:os.system ['true']\n", ["line 1", "name has the tag", "not supported"]),
    ("name: !!python/name:os.system ''\n", ["line 1", "has the tag"]),
    ("name: !own a\n", ["line 1", "name has the tag !own"]),
    ("name: !!binary aGVsbG8=\n", ["line 1", "has the tag"]),
    ("params: {mass: !!int x}\n", ["line 1", "params.mass is tagged !!int"]),
    ("params: {mass: !!timestamp 2020-01-01}\n", ["line 1", "params.mass has the tag"]),
    ("base: &b {mass: 1}\nparams: {<<: *b}\n", ["line 2", "merge key"]),
    ("name: &a [*a]\n", ["line 1", "contains itself through an alias"]),
    ("name: a\nparams: {mass: 1\x07}\n", ["line 2", "control character"]),
    ("[" * 700, ["nested too deep"]),
    ("a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(f"{k}: &{k} [{','.join(['*' + p] * 9)}]\n" for p, k in
     zip("abcdefgh", "bcdefghi", strict=True)), ["more than 100000 values"]),
    (b"\xff\xfe\x00\x01", ["is not text in UTF-8"]),
    (b"\x89PNG\r\n\x1a\n\x00\x00", ["is not text"]),
    (GOOD.encode("utf-16"), ["is not text in UTF-8"]),
    (b"PK\x03\x04\x00\x00", ["is not text"]),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), FILES, ids=[repr(text)[:50] for text, _ in FILES])
def test_files_that_are_not_jobs(tmp_path: Path, text: str | bytes, words: list[str]) -> None:
    message = refused(written(tmp_path, text))
    assert "bad.yaml" in message
    for word in words:
        assert word in message


def test_a_file_that_is_missing(tmp_path: Path) -> None:
    written(tmp_path, GOOD, "quick_basins.yaml")
    message = refused(tmp_path / "quick_basin.yaml")
    assert "quick_basin.yaml" in message
    assert "does not exist; did you mean quick_basins.yaml?" in message
    assert f"does not exist, nor does its folder {tmp_path}/nowhere." in refused(
        tmp_path / "nowhere" / "a.yaml"
    )
    # what the documentation writes, in a folder that is no checkout
    message = refused(tmp_path / "sweeps" / "quick_basins.yaml")
    assert "does not exist; did you mean builtin:quick_basins, which comes with gaitsweep?" in message


def test_a_directory(tmp_path: Path) -> None:
    written(tmp_path, GOOD, "quick.yaml")
    assert "is a directory, not a file. It holds quick.yaml." in refused(tmp_path)


def test_a_name_that_no_file_can_have() -> None:
    assert "cannot be read" in refused(Path("a\x00b.yaml"))
    assert "cannot be read" in refused(Path("a" * 300))


CONFIGS = [
    ("model: toy_model:Toy\nparams:\n  mas: 1\n", ["paper.yaml, line 3", "params.mas", "did you mean mass?"]),
    ("params:\n  stiffness: -1\n", ["paper.yaml, line 2", "params.stiffness is -1", "above 0"]),
    ("parmas: {}\n", ["paper.yaml, line 1", "parmas is not a field of a config", "did you mean params?"]),
    ("params: 3\n", ["paper.yaml, line 1", "params is 3"]),
    ("params: {mass: [1\n", ["paper.yaml, line 2", "not closed"]),
    ("structure: {N: 99}\n", ["paper.yaml, line 1", "structure.N is 99"]),
    ("", ["bad.yaml, line 2: config names", "paper.yaml, which is empty"]),
]


@pytest.mark.parametrize(("config", "words"), CONFIGS)
def test_a_config_that_is_wrong(tmp_path: Path, config: str, words: list[str]) -> None:
    written(tmp_path, config, "paper.yaml")
    text = "name: a\nconfig: paper.yaml\nmodel: toy_model:Toy\nrun: {kind: settle}\n"
    message = refused(written(tmp_path, text))
    for word in words:
        assert word in message


OVERRIDES = [
    ("run.max_cycels=10", ["--set run.max_cycels=10: run.max_cycels", "did you mean max_cycles?"]),
    ("params.mas=1", ["--set params.mas=1: params.mas", "did you mean mass?"]),
    ("params.mass=-1", ["--set params.mass=-1: params.mass is -1", "above 0"]),
    ("rum.max_cycles=1", ["--set rum.max_cycles=1: rum is not a field", "did you mean run?"]),
    ("vary.launch_1.linspace=[1,2,x]", ["--set vary.launch_1.linspace=[1,2,x]: vary.launch_1.linspace[2]"]),
    (
        "vary.launch_1.linspace=[-1,2,3]",
        ["--set vary.launch_1.linspace=[-1,2,3]: vary.launch_1 is -1 in row 0"],
    ),
    ("run.kind.x=1", ['--set run.kind.x=1: run.kind is "settle" and has no fields']),
    ("figures.x=1", ["--set figures.x=1: figures is a list", "write the whole list, figures=[...]"]),
    (
        "figures=[{kind: basin, x: launch_1, y: launch_1}, {kind: basin, x: launch_1, y: row}]",
        ["name: basin_2"],
    ),
    ("params.mass", ["--set params.mass: ", "key=value"]),
    ("=3", ["--set =3: ", "key=value"]),
    ("params..mass=3", ["--set params..mass=3: ", "key=value"]),
    ("vary.sample.n=", ["vary.sample.n is empty, but must be a number. Write a value after ="]),
    ("params.mass=[1", ["--set params.mass=[1", "not closed"]),
    ("params.mass=", ["--set params.mass=: params.mass is empty", "Write a value after ="]),
    ("engine.lanes=many", ["--set engine.lanes=many: engine.lanes", "unknown"]),
    ("name=" + "x" * 200, ["--set name=xxx", "letters, digits"]),
]


@pytest.mark.parametrize(("override", "words"), OVERRIDES)
def test_an_override_that_is_wrong(tmp_path: Path, override: str, words: list[str]) -> None:
    message = refused(written(tmp_path, GOOD), override)
    for word in words:
        assert word in message


MODELS = [
    ("raise RuntimeError('no device')", ["cannot be imported: RuntimeError (", ", line 1): no device"]),
    ("import nothing_of_that_name", ["cannot be imported", "nothing_of_that_name"]),
    ("def f(:", ["cannot be imported: SyntaxError"]),
    ("x = 1", ["has no Own"]),
    ("import sys; sys.exit(3)", ["cannot be imported"]),
    (
        "import dataclasses\nimport toy_model\nfrom gaitsweep.contract import Quantity\n"
        "@dataclasses.dataclass(frozen=True)\nclass Own(toy_model.Toy):\n"
        "    parameters = (Quantity('e', '1', 'restitution', 0.5),)\n",
        ["has a quantity named e", "rename it"],
    ),
    (
        "import dataclasses\nimport toy_model\n\n"
        "@dataclasses.dataclass(frozen=True)\nclass Own(toy_model.Toy):\n"
        "    def __post_init__(self):\n        raise ValueError('N must be even')\n",
        ["structure is not accepted by", "N must be even"],
    ),
    (
        "import toy_model\nclass Own(toy_model.Toy):\n"
        "    def flow(self, params, state):\n        return {'hieght': state.speed}\n",
        ["its function flow", "hieght", "did you mean height?"],
    ),
    (
        "import toy_model\nclass Own(toy_model.Toy):\n"
        "    def init(self, params, start):\n        return dict(vars(super().init(params, start)))\n",
        ["its function init returns dict", "frozen dataclass."],
    ),
    (
        "import toy_model\nclass Own(toy_model.Toy):\n"
        "    def guards(self, params, state):\n        return -state.height[0]\n",
        ["its function guards returns ()", "(n,)"],
    ),
    (
        "import toy_model\nclass Own(toy_model.Toy):\n"
        "    def failed(self, params, state):\n        return bool(state.height[0] > 2)\n",
        ["its function failed raises TracerBoolConversionError", "Use jnp.where"],
    ),
    (
        "import toy_model\nclass Own(toy_model.Toy):\n"
        "    def observe(self, params, state):\n        return {'launch': state.launch[0]}\n",
        ["its function observe", "launch_1", "it returns launch."],
    ),
    (
        "import dataclasses\nimport toy_model\n"
        "class Own(toy_model.Toy):\n    def jump(self, params, state, fired):\n"
        "        return dataclasses.replace(state, bounces=state.bounces.sum())\n",
        ["its function jump", "bounces", "()", "init", "(1,)."],
    ),
    (
        "import toy_model\nclass Own(toy_model.Toy):\n    __hash__ = None\n",
        ["cannot be hashed", "frozen dataclass"],
    ),
]


@pytest.mark.parametrize(("source", "words"), MODELS)
def test_a_model_of_ones_own_that_is_wrong(tmp_path: Path, source: str, words: list[str]) -> None:
    module = f"own_{len(source)}"
    written(tmp_path, source, f"{module}.py")
    path = written(tmp_path, f"name: a\nmodel: {module}:Own\nrun: {{kind: settle}}\n")
    with pytest.raises(JobError) as error:
        load_job(path)
    for word in words:
        assert word in str(error.value)


def test_a_namesake_is_not_simulated_instead(tmp_path: Path) -> None:
    written(tmp_path, "x = 1", "toy_model.py")
    message = refused(written(tmp_path, GOOD))
    assert "line 2: model is toy_model:Toy, but another module toy_model has been loaded from" in message


def test_an_edited_model_is_loaded_again(tmp_path: Path) -> None:
    """A notebook's next cell uses the new file, and reports its errors."""
    source = "import toy_model\nclass Own(toy_model.Toy):\n    name = 'before'\n"
    written(tmp_path, source, "own_edited.py")
    path = written(tmp_path, "name: a\nmodel: own_edited:Own\nrun: {kind: settle}\n")
    first = load_job(path).design.model
    assert (first.name, load_job(path).design.model) == ("before", first)
    written(tmp_path, source.replace("before", "afterwards"), "own_edited.py")
    assert load_job(path).design.model.name == "afterwards"
    written(tmp_path, "class Own(", "own_edited.py")
    for _ in range(2):
        with pytest.raises(JobError, match="own_edited cannot be imported: SyntaxError"):
            load_job(path)


def test_several_things_at_once(tmp_path: Path) -> None:
    """The first few, a line each, in the order of the file."""
    lines = GOOD.splitlines()
    lines[2] = "params: {mas: 2, kik: 1}"
    lines[4] = "  lunch_1: [1, 2]"
    lines[5] = "run: {kind: settle, max_cycels: 1, tolerance: 0}"
    lines[6] = "numerics: {dt: 0}"
    message = refused(written(tmp_path, "\n".join(lines)))
    numbers = [int(number) for number in re.findall(r"bad\.yaml, line (\d+): ", message)]
    assert numbers == [3, 3, 5, 6, 6]
    assert message.endswith("... and 1 more.")


@pytest.mark.parametrize(
    ("section", "typo", "follows"),
    [
        ("name:", "nmae:", ["name is missing"]),
        ("vary:", "vray:", ["figures[0].x is launch_1"]),
        ("run:", "rnu:", ["run is missing"]),
    ],
)
def test_the_typo_of_a_section_comes_before_what_follows_from_it(
    tmp_path: Path, section: str, typo: str, follows: list[str]
) -> None:
    first, *further = refused(written(tmp_path, GOOD.replace(section, typo))).splitlines()
    assert f"{typo[:-1]} is not a field of a job; did you mean {section[:-1]}?" in first
    assert all(word in each for each, word in zip(further, follows, strict=True))


def test_in_python_the_field_is_named() -> None:
    with pytest.raises(JobError) as error:
        Job(name="a", model="toy_model:Toy", vary={"mas": [1]}, run={"kind": "settle"})
    assert str(error.value).startswith(
        "vary.mas is not a parameter or start value of toy; did you mean mass?"
    )
    with pytest.raises(JobError, match="run is missing"):
        Job(name="a", model="toy_model:Toy")  # type: ignore[call-arg]


def test_a_refused_number_has_the_digits_for_which_it_is_refused() -> None:
    with pytest.raises(InvalidValue, match=r"is 2\.9999999999999996, but must be a whole number"):
        read_whole("0.3 / 0.1", 1, 9)
    with pytest.raises(InvalidValue, match=r"is 1000000\.5, but must be a whole number"):
        read_whole(1000000.5, 1, 10**9)
    with pytest.raises(InvalidValue, match=r"is 1\.0000000000000002, but must be from 0 to 1\."):
        read_real(1.0000000000000002, 0.0, 1.0)
    with pytest.raises(InvalidValue, match=r"is 2, but must be at most 1\."):
        read_real(2.0, high=1.0)


JUNK = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.just("1+")),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=5,
)
FIELDS = [
    "name", "model", "structure", "structure.N", "config", "params", "params.mass", "start", "start.launch_1",
    "vary", "vary.launch_1", "vary.launch_1.linspace", "vary.zip", "vary.zip.preload", "vary.sample",
    "vary.sample.of", "run", "run.kind", "run.max_cycles", "numerics", "numerics.dt", "engine",
    "engine.lanes", "figures", "new",
]  # fmt: skip


@pytest.mark.slow
@given(st.sampled_from(FIELDS), JUNK)
def test_any_value_of_any_field_is_read_or_refused(field: str, junk: Any) -> None:
    """No exception other than JobError is raised."""
    job = yaml.safe_load(GOOD)
    del job["figures"]
    *outer, last = field.split(".")
    inside: Any = job
    for key in outer:
        inside = inside.setdefault(key, {})
    inside[last] = junk
    with contextlib.suppress(JobError):
        Job(**job)


@given(st.text(max_size=60))
def test_any_content_of_a_file_is_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "junk.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    with pytest.raises(JobError):
        load_job(path)
