"""Jobs that ask for figures of hysteresis, return maps, branches and gait maps: read, or refused in words."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest
import yaml

from gaitsweep import plot
from gaitsweep.job import Job, load_job
from gaitsweep.plot.figure_style import STYLE_FIELDS
from tests.support.job_files import MAP, RAMP, refused, written

STAIRS = "{kind: staircase, parameter: stiffness, path: [4, 9, 4], step: 1, dwell: 5}"
SETTLE = "{kind: settle}"
TEMPLATE = """\
name: quick
model: toy_model:Toy
vary: {{launch_1: [1, 2], mass: [1, 2]}}
run: {run}
figures:
  - {figure}
"""

GOOD = [
    (RAMP, "{kind: hysteresis, y: launch_1}"),
    (
        RAMP,
        "{kind: hysteresis, y: launch_1, parameter: stiffness, with_table: a, least: 2/10, panels: mass}",
    ),
    (STAIRS, "{kind: hysteresis, y: launch_1, title: Up and down, name: loop}"),
    (MAP, "{kind: return_map, y: launch_1, panels: mass}"),
    (MAP, "{kind: return_map, y: launch_1, panels: mass, form: next, bandwidth: 0.1}"),
    (MAP, "{kind: branches, y: launch_1, x: mass}"),
    (SETTLE, "{kind: gait_map, x: mass, y: launch_1}"),
]
BAD = [
    (RAMP, "{kind: hysteresis}", ["figures[0].y is missing", "observable of the model"]),
    (RAMP, "{kind: hysteresis, y: lunch_1}", ["figures[0].y is lunch_1", "did you mean launch_1?"]),
    (
        RAMP,
        "{kind: hysteresis, y: launch_1, parameter: mass}",
        ["figures[0].parameter is mass", "moves stiffness"],
    ),
    (
        RAMP,
        "{kind: hysteresis, y: launch_1, panels: mas}",
        ["figures[0].panels is mas", "did you mean mass?"],
    ),
    (RAMP, "{kind: hysteresis, y: launch_1, least: 0}", ["figures[0].least is 0", "above 0"]),
    (RAMP, "{kind: hysteresis, y: launch_1, x: stiffness}", ["figures[0].x is stiffness", "an observable"]),
    (MAP, "{kind: hysteresis, y: launch_1}", ["needs a run of kind ramp or staircase, not return_map"]),
    (MAP, "{kind: return_map, y: 3}", ["figures[0].y is 3", "must be text"]),
    # the run of this name has crossings, its figure does not
    (MAP, "{kind: return_map, y: launch_1, crossings: 3}", ["figures[0].crossings", "a figure (return_map)"]),
    (MAP, "{kind: return_map}", ["figures[0].y is missing"]),
    (MAP, "{kind: return_map, y: launch_1}", ["figures[0].panels leaves out mass"]),
    (MAP, "{kind: return_map, y: launch_1, form: both}", ["figures[0].form", "Allowed: change, next"]),
    (
        MAP,
        "{kind: return_map, y: launch_1, bandwidth: wide}",
        ["figures[0].bandwidth", "wide is unknown here"],
    ),
    (RAMP, "{kind: return_map, y: launch_1}", ["needs a run of kind return_map, not ramp"]),
    (MAP, "{kind: branches, y: launch_1, x: stiffness}", ["figures[0].x is stiffness", "not a column"]),
    (MAP, "{kind: branches, y: launch_1}", ["figures[0].x is missing"]),
    (SETTLE, "{kind: branches, y: launch_1, x: mass}", ["needs a run of kind return_map, not settle"]),
    (SETTLE, "{kind: gait_map, x: mass, y: mas}", ["figures[0].y is mas", "did you mean mass?"]),
    (SETTLE, "{kind: gait_map, x: mass, y: launch_1, hue: gate}", ["did you mean gait?"]),
    (RAMP, "{kind: gait_map, x: mass, y: launch_1}", ["needs a run of kind settle", "not ramp"]),
    (RAMP, "{kind: hysteresys, y: launch_1}", ["did you mean hysteresis?", "return_map", "gait_map"]),
    ("{kind: return_mp, crossings: 5}", "{kind: return_map, y: launch_1}", ["did you mean return_map?"]),
]


@pytest.mark.parametrize(("run", "figure"), GOOD)
def test_a_job_with_such_a_figure(tmp_path: Path, run: str, figure: str) -> None:
    job = load_job(written(tmp_path, TEMPLATE.format(run=run, figure=figure)))
    (found,) = job.resolved()["figures"]
    asked = yaml.safe_load(figure)
    assert found.items() >= {**asked, **({"least": 0.2} if "least" in asked else {})}.items()
    again = Job(**job.resolved())
    assert again.figures == job.figures
    assert {"name", "title"} <= set(found)
    given = {key: value for key, value in found.items() if key not in ("kind", "name")}
    assert set(given) <= _arguments(found["kind"])


@pytest.mark.parametrize(("run", "figure", "words"), BAD)
def test_a_figure_that_is_wrong(tmp_path: Path, run: str, figure: str, words: list[str]) -> None:
    message = refused(written(tmp_path, TEMPLATE.format(run=run, figure=figure)))
    assert ("line 4" if "return_mp" in run else "line 6") in message
    for word in words:
        assert word in message


def test_every_kind_of_figure_is_drawn_with_its_jobs_fields() -> None:
    for kind, part in plot.FIGURES.items():
        assert set(part.model_fields) - {"kind", "name", *STYLE_FIELDS} <= _arguments(kind)


def _arguments(kind: str) -> set[str]:
    return set(inspect.signature(plot.FIGURES[kind].draw).parameters) - {"table"}
