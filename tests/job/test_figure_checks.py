"""A figure that cannot be drawn of a job's table is refused before rows run; one that is not, is drawn."""

from __future__ import annotations

from typing import Any

import pytest
from matplotlib import pyplot as plt

from gaitsweep.errors import UserError
from gaitsweep.job import Job, JobError
from gaitsweep.plot import draw
from gaitsweep.plot.columns import PlotError
from gaitsweep.schema.diagnostics import dotted
from tests.support.job_tables import table_of

GRID = {"psi_1": {"linspace": [1, 2, 4]}, "psi_2": {"linspace": [1, 1.5, 3]}}
MASSES = {"m_B": {"values": [0.85, 0.9]}}
TWO = {**MASSES, "omega": {"values": [0.4, 0.5]}}
BOTH = {**GRID, **MASSES}
SEEDS = {"seed": [1, 2]}
PSI = {"x": "psi_1", "y": "psi_2"}
REFINED = {"kind": "settle", "refine": "boundary"}
SETTLE: dict[str, Any] = {"kind": "settle"}
TIMED = {"kind": "fixed_time", "duration": 5}
MAP = {"kind": "return_map", "crossings": 20}
TRACE = {"kind": "trace", "duration": 1, "every": 0.05}
BRANCH = {"kind": "continuation", "parameter": "beta", "path": [0.7, 0.8]}
ATLAS = {**BRANCH, "kind": "atlas", "ranges": {"psi_1": [1, 2], "psi_2": [1, 2], "psi_3": [1, 2]}}
FEET = "planar_quadruped"


def job(
    figure: dict[str, Any], run: dict[str, Any] = SETTLE, vary: Any = GRID, model: str = "multilegged"
) -> Job:
    start = {name: 1.0 for name in ("psi_1", "psi_2", "psi_3") if name not in vary}
    return Job(name="x", model=model, vary=vary, run=run, figures=[figure],
               start=start if model == "multilegged" else {})  # fmt: skip


# (figure, run, vary, model, words of the refusal): what ended in a traceback, or a refusal, after all rows
REFUSED: list[tuple[dict[str, Any], dict[str, Any], Any, str, str]] = [
    ({"kind": "shock", "x": "psi_1", "y": "m_B"}, SETTLE, BOTH, "", "psi_1 in rad and m_B in kg"),
    ({"kind": "shock", **PSI}, SETTLE, BOTH, "", "leaves out m_B, which varies"),
    ({"kind": "shock", "x": "psi_1", "y": "gait"}, SETTLE, GRID, "", "y is gait, which is not numeric"),
    ({"kind": "orbit", "x": "m_B", "y": "psi_1"}, SETTLE, TWO, "", "panels leaves out omega, in which"),
    ({"kind": "basin", **PSI}, SETTLE, BOTH, "", "leaves out m_B, which varies"),
    ({"kind": "basin", "x": "psi_1", "y": "status"}, SETTLE, GRID, "", "y is status, which is not numeric"),
    ({"kind": "basin", "x": "psi_1", "y": "psi_1"}, SETTLE, GRID, "", "y is psi_1, like x"),
    ({"kind": "basin", **PSI, "title": "$\\foo$"}, SETTLE, GRID, "", "title is .*cannot typeset"),
    ({"kind": "gait_map", "x": "psi_1", "y": "psi_1"}, SETTLE, GRID, "", "y is psi_1, like x"),
    ({"kind": "gait_map", "x": "gait", "y": "psi_1"}, SETTLE, GRID, "", "x is gait, which is not numeric"),
    ({"kind": "basin_measures", "panels": "m_B"}, SETTLE, MASSES, "", "axes is missing: besides panels"),
    ({"kind": "basin_measures", "axes": ["gait"]}, SETTLE, GRID, "", r"axes\[0\] is gait, which is not"),
    ({"kind": "basin_measures", "hue": "attractor"}, REFINED, GRID, "", "hue is attractor"),
    ({"kind": "basin", **PSI, "hue": "k"}, REFINED, GRID, "", "hue is k, but run.refine infers rows"),
    ({"kind": "shock", **PSI, "hue": "k"}, REFINED, GRID, "", "hue is k, but run.refine infers rows"),
    ({"kind": "basin_measures", "hue": "psi_1_end"}, REFINED, GRID, "", "hue is psi_1_end, but run.refine"),
    ({"kind": "basin_measures", "hue": "attractor"}, TIMED, GRID, "", "not test whether rows settle"),
    ({"kind": "gait_transitions", **PSI, "start": "psi_1"}, SETTLE, GRID, "", "start is psi_1, like x"),
    ({"kind": "branches", "x": "crossing", "y": "psi_1"}, MAP, MASSES, "", "crossing, which does not vary"),
    ({"kind": "cycles", "x": "status", "y": ["psi_1"]}, MAP, MASSES, "", "x is status, which is not numeric"),
    ({"kind": "drift_law", "of": "kappa"}, SETTLE, GRID, "", "kappa_1 and kappa_end must vary"),
    ({"kind": "gait_shares", "x": "psi_1"}, SETTLE, BOTH, "", "not a varying parameter.*: m_B"),
    ({"kind": "stable_ranges", "y": "gait"}, BRANCH, MASSES, "", "y is gait, which is not numeric"),
    ({"kind": "speed_gaits", "speed": "psi_1"}, SETTLE, GRID, "", "swing onsets of four legs"),
    ({"kind": "gait_series"}, TRACE, MASSES, "", "needs the signal pitch"),
    ({"kind": "gait_series", "row": 3}, TRACE, SEEDS, FEET, "row is 3, but the job has rows 0 to 1"),
    ({"kind": "gait_series", "window": [2, 1]}, TRACE, SEEDS, FEET, "its beginning must be before its end"),
    ({"kind": "gait_series", "strip_columns": 3}, TRACE, SEEDS, FEET, "is 3, but must be 1 or 2"),
    ({"kind": "footprints", "window": [2, 2]}, TRACE, MASSES, "", "its beginning must be before its end"),
    ({"kind": "footprints", "panels": None}, TRACE, MASSES, "", "differ in m_B in one panel.* panels: row"),
    ({"kind": "footprints", "panels": "m_B"}, TRACE, TWO, "", "differ in omega in one panel"),
    ({"kind": "nine_gaits"}, TRACE, MASSES, "", "needs the signal u_f_LF"),
    ({"kind": "loading_rule", "measures": ["load_lat"]}, TRACE, SEEDS, FEET, "did you mean load_late"),
    ({"kind": "loading_rule", "only": "seed"}, TRACE, SEEDS, FEET, "value is missing, but only"),
    ({"kind": "chain_theory", "show": "sets", "k": 4}, TRACE, MASSES, "", "k is 4, but a chain of 4 legs"),
    ({"kind": "chain_theory", "show": "sets"}, TRACE, SEEDS, FEET, "needs the multi-legged chain's psi_1"),
    ({"kind": "wave_speed", "x": "beta"}, TRACE, MASSES, "", "x is beta, which does not vary in this job"),
    ({"kind": "road_map", "row": True}, ATLAS, MASSES, "", "row is true, but must be a number"),
    ({"kind": "footprints"}, TRACE, {"launch_1": [1]}, "toy_model:Toy", "needs the signals contact_1"),
]  # fmt: skip


@pytest.mark.parametrize(("figure", "run", "vary", "model", "words"), REFUSED)
def test_refused_before_rows_run(
    figure: dict[str, Any], run: dict[str, Any], vary: Any, model: str, words: str
) -> None:
    with pytest.raises(JobError, match=words) as error:
        job(figure, run, vary, model or "multilegged")
    assert "figures[0]" in str(error.value)
    assert len(error.value.diagnostics) == 1


def test_two_figures_of_one_name_are_refused_once() -> None:
    figure = {"kind": "orbit", "x": "m_B", "y": "psi_1"}
    start = {f"psi_{number}": 1.0 for number in (1, 2, 3)}
    with pytest.raises(JobError) as error:
        Job(name="x", model="multilegged", vary=MASSES, run=SETTLE, start=start, figures=[figure, figure])
    assert str(error.value).count("figures[1].name is orbit, like that of figures[0]") == 1


DRAWN: list[tuple[dict[str, Any], dict[str, Any], Any]] = [
    ({"kind": "shock", **PSI, "panels": "m_B"}, SETTLE, BOTH),
    ({"kind": "basin", **PSI, "panels": "m_B"}, SETTLE, BOTH),
    (
        {"kind": "basin", "x": "psi_1", "y": "m_B", "title": "$m_B$ costs \\$5"},
        SETTLE,
        {"psi_1": [1, 2], **MASSES},
    ),
    ({"kind": "basin", **PSI, "hue": "outcome"}, REFINED, GRID),
    ({"kind": "basin_measures", "panels": "m_B"}, SETTLE, BOTH),
    ({"kind": "gait_map", "x": "psi_1", "y": "m_B"}, SETTLE, BOTH),
    ({"kind": "gait_shares", "x": "m_B"}, SETTLE, BOTH),
    ({"kind": "branches", "x": "m_B", "y": "psi_1"}, MAP, MASSES),
    ({"kind": "branches", "x": "m_B", "y": "psi_1"}, MAP, {**MASSES, "omega": [0.4]}),  # one value of omega
    ({"kind": "cycles", "y": ["psi_1"]}, MAP, MASSES),
    ({"kind": "footprints"}, TRACE, MASSES),
    ({"kind": "footprints", "panels": "m_B"}, TRACE, MASSES),
    ({"kind": "chain_theory", "show": "order", "k": 2}, SETTLE, BOTH),
]


@pytest.mark.parametrize(("figure", "run", "vary"), DRAWN)
def test_accepted_figures_are_drawn(figure: dict[str, Any], run: dict[str, Any], vary: Any) -> None:
    checked = job(figure, run, vary)
    spec = checked.resolved()["figures"][0]
    given = {k: v for k, v in spec.items() if v is not None and k not in ("kind", "name")}
    draw(spec["kind"], table_of(checked), **given)
    plt.close("all")


def test_plot_refuses_what_check_refuses() -> None:
    """The rules are those of the figures, which apply to existing tables too."""
    table = table_of(job({"kind": "basin", **PSI, "panels": "m_B"}, vary=BOTH))
    with pytest.raises(PlotError, match="Several rows have the same psi_1 and psi_2"):
        draw("basin", table, x="psi_1", y="psi_2")
    with pytest.raises(UserError, match="A distance needs one unit"):
        draw("shock", table, x="psi_1", y="m_B")
    plt.close("all")


def test_one_error_does_not_hide_another() -> None:
    """Errors of style, numerics, params and figures are reported at once, each at its own place."""
    fields: dict[str, Any] = {
        "name": "x",
        "model": "multilegged",
        "start": {"psi_3": 1.0},
        "vary": GRID,
        "run": SETTLE,
        "figures": [{"kind": "basin", "x": "psi_1"}, {"kind": "basin", "x": "kapa", "y": "psi_2"}],
    }

    def wrong(**more: Any) -> set[str]:
        with pytest.raises(JobError) as error:
            Job(**fields | more)
        return {dotted(diagnostic.path) for diagnostic in error.value.diagnostics}

    figures = {"figures[0].y", "figures[1].x"}
    assert wrong() == figures
    assert wrong(style={"widht": 85}) == {"style.widht", *figures}
    with pytest.raises(JobError, match=r"style.shares is not a field.*in an entry of figures \(basin, "):
        Job.model_validate({**fields, "style": {"shares": False}})
    with pytest.raises(JobError, match="width is not a field of a job: it belongs under style"):
        Job.model_validate({**fields, "width": "column"})
    with pytest.raises(JobError, match="sample is not a field of a job: it belongs under vary"):
        Job.model_validate({**fields, "sample": {"n": 3}})
    assert wrong(verify=-1, params={"m_B": -1.0}) == {"verify", *figures, "params.m_B"}
    # what follows from an error is not one of its own
    assert wrong(params={"bta": 1.0, "m_B": -1.0}) == {"params.bta", *figures}
    assert wrong(run={"kind": "setle"}) == {"run.kind", "figures[0].y"}
    ramp = {"kind": "ramp", "parameter": "bta", "path": [0, 1], "rate": 1.0}
    assert wrong(run=ramp) >= {"run.parameter", "figures[0].y"}
