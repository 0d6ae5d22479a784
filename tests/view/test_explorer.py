"""The explorer's page: its numbers against the table, its motions against runs of the same starts."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import itertools
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import PIL.Image
import PIL.ImageColor
import PIL.ImageSequence
import pytest
from typer.testing import CliRunner

import gaitsweep as gs
from gaitsweep import view
from gaitsweep.analysis.atlas.branch import StoredPoint
from gaitsweep.api.result import Result
from gaitsweep.cli import commands
from gaitsweep.contract import Quantity
from gaitsweep.engine.poincare.maps import Points
from gaitsweep.examples.hopper import Hopper
from gaitsweep.plot import theme
from gaitsweep.runs.dataset import MissingPackageError
from gaitsweep.view.explorer.animated_records import AnimatedRecords
from gaitsweep.view.explorer.explorer import write_explorer
from gaitsweep.view.explorer.page_format import (
    RESOLUTION,
    columns_of,
    fast_to_load,
    html_symbol,
    motion_fields,
    packed,
)
from gaitsweep.view.explorer.replay_groups import _points_of_records
from gaitsweep.view.explorer.replays import Motion, Pictures, Stretch, pictures_of
from gaitsweep.view.explorer.start_map import CELLS, StartMap, boundary, map_of, spread, subgrid, with_next
from gaitsweep.view.movie.animation import Clip
from gaitsweep.view.movie.side_view import heading, projected, turned, with_points
from hostile_texts import ATTACK, HostileTexts
from tests.support.browser import Page, browser, program
from tests.support.job_tables import table_of
from tests.support.trace_directories import CYCLE, quadruped_skeleton
from toy_model import flight_time

SIDE = 6
PSI_3 = (0.4 * math.pi, math.pi)


def fields_of(page: Path) -> dict[str, Any]:
    """Data of a page, as its script unpacks them."""
    result = re.search(r'id="data">([^<]*)</script>', page.read_text())
    assert result is not None
    return json.loads(gzip.decompress(base64.b64decode(result[1])))


def numbers_of(text: str) -> np.ndarray:
    """Whole numbers of two bytes, stored as low bytes and high bytes."""
    planes = np.frombuffer(base64.b64decode(text), np.uint8).reshape(2, -1)
    return np.ascontiguousarray(planes.T).view("<i2").ravel().astype(int)


def points_of(motion: dict[str, Any]) -> np.ndarray:
    """The points of a stretch, (pictures, columns) m, the last column the camera's path."""
    steps = numbers_of(motion["points"]).reshape(-1, motion["pictures"])
    return np.cumsum(steps, axis=1).T * motion["unit"]


def shown_map(outcome: np.ndarray, closed: tuple[bool, bool] = (False, False)) -> StartMap:
    """A map of cells with these outcomes (across, up)."""
    across, up = outcome.shape
    at = np.array([(i, j) for i in range(across) for j in range(up)])
    edges = np.arange(across + 1.0), np.arange(up + 1.0)
    return StartMap(
        pd.DataFrame({"row": range(len(at))}), CELLS, "x", "y", [], [], outcome.ravel(), edges, at, closed
    )


def test_stretches_are_stored_to_a_thousandth_of_the_height() -> None:
    random = np.random.default_rng(0)
    points, camera = random.normal(size=(9, 4)), np.linspace(3.0, 5.0, 9)
    contact = np.array([[1, 1, 0, 0, 1, 1, 1, 0, 0], [0, 0, 0, 1, 1, 1, 1, 1, 1]]).T
    motion = Motion(
        Stretch("x", 0.0, 1.0), np.linspace(0.0, 1.0, 9), 1, contact, Pictures(points, camera, 1.0, 2.0, 0.3)
    )
    fields = motion_fields(motion)
    result = points_of(fields)
    np.testing.assert_allclose(result[:, :-1], points, atol=0.51 * RESOLUTION * 2.0)
    np.testing.assert_allclose(fields["ground"] + result[:, -1], camera, atol=0.51 * RESOLUTION * 2.0)
    assert fields["contact"] == [[0, 2, 4, 7], [3, 9]]


def test_whole_numbers_come_back() -> None:
    numbers = np.array([0, 1, -1, 255, 256, -32768, 32767])
    np.testing.assert_array_equal(numbers_of(packed(numbers)), numbers)


def test_a_body_that_is_never_finite_has_no_pictures() -> None:
    skeleton = with_points(quadruped_skeleton(), lambda points: points * np.nan)
    pictures = pictures_of(skeleton, 0.01 * np.arange(81), CYCLE)
    assert (len(pictures.points), pictures.half, pictures.height) == (0, 0.0, 0.0)


def test_corners_of_a_body_keep_their_order_in_all_pictures() -> None:
    """The page draws between two pictures, so a corner that changes its place would fly through the body."""
    skeleton = quadruped_skeleton()  # its waist rolls
    skeleton = turned(skeleton, heading(skeleton))
    drawn = pictures_of(skeleton, 0.01 * np.arange(81), CYCLE).points
    drawn = drawn.reshape(len(drawn), -1, 2)
    first, intervals = sum(limb.points.shape[1] for limb in skeleton.limbs), len(drawn) - 1
    for body in skeleton.bodies:
        corners, size = projected(body - body.mean(axis=1, keepdims=True)), body.shape[1]
        shown = drawn[:, first : first + size]
        shown = shown - shown.mean(axis=1, keepdims=True)
        apart = np.linalg.norm(shown[:, :, None] - corners[:, None], axis=-1)
        order = apart.argmin(axis=2)
        assert apart.min(axis=2).max() < 1e-9
        assert np.count_nonzero((order[1:] == order[:-1]).all(axis=1)) == intervals == 80
        # the first half is the near side, whose y is negative
        assert body[:, order[0, : size // 2], 1].max() < body[:, order[0, size // 2 :], 1].min()
        first += size


def test_a_return_map_has_the_change_to_the_next_crossing() -> None:
    """A change of an angle is the shorter way round, and no angle of a circle itself."""
    table = pd.DataFrame({"row": [0, 0, 0, 1], "crossing": [1, 2, 3, 1], "psi_1_n": [0.1, 6.2, 0.3, 2.0]})
    table.attrs = {"quantities": {"psi_1": {"symbol": "", "circular": True}}}
    result = with_next(table, "psi_1_n")
    np.testing.assert_allclose(result["psi_1_n_next"], [6.2, 0.3])
    np.testing.assert_allclose(result["psi_1_n_change"], [6.1 - 2 * np.pi, 0.3 - 6.2 + 2 * np.pi])
    circular = {each["name"]: each["circular"] for each in columns_of(result)}
    assert circular == {
        "row": False,
        "crossing": False,
        "psi_1_n": True,
        "psi_1_n_next": True,
        "psi_1_n_change": False,
    }


def test_boundary_cells_are_those_beside_another_outcome() -> None:
    outcome = np.zeros((6, 5), int)
    outcome[3:] = 1
    result = boundary(shown_map(outcome)).reshape(6, 5)
    np.testing.assert_array_equal(np.flatnonzero(result.all(axis=1)), [2, 3])
    assert not result[[0, 1, 4, 5]].any()
    around = boundary(shown_map(outcome, (True, False))).reshape(6, 5)
    np.testing.assert_array_equal(np.flatnonzero(around.any(axis=1)), [0, 2, 3, 5])


def test_every_beginning_of_the_order_is_spread_evenly() -> None:
    np.testing.assert_array_equal(np.sort(spread(13)), np.arange(13))
    assert np.diff(np.sort(spread(1000)[:10])).max() < 200
    order = subgrid(shown_map(np.zeros((9, 9), int)))
    np.testing.assert_array_equal(np.sort(order), np.arange(81))
    first = np.array([divmod(record, 9) for record in order[:4]])
    assert len({tuple(each) for each in (first >= 4).tolist()}) >= 3  # in different quarters


@pytest.mark.parametrize(
    ("symbol", "shown"),
    [
        (r"\psi_{1}", "ψ<sub>1</sub>"),
        (r"x_\mathrm{c, fore}", "x<sub>c, fore</sub>"),
        (r"\Delta^*_{12}", "Δ<sup>*</sup><sub>12</sub>"),
        (r"\dot\theta_{ns}", "θ̇<sub>ns</sub>"),
        (r"a<b", "a&lt;b"),
        (r"\frac{a}{b}", "q"),
    ],
)
def test_symbols_are_shown_as_html(symbol: str, shown: str) -> None:
    table = pd.DataFrame({"q": [1.0]})
    table.attrs = {"quantities": {"q": {"symbol": symbol}}}
    assert html_symbol(table, "q") == shown


@pytest.fixture(scope="module")
def wells(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result of a model of a user's own that says nothing of how it is drawn."""
    folder = tmp_path_factory.mktemp("wells")
    gs.sweep(
        "double_well:DoubleWell",
        x_0=np.linspace(-1.5, 1.5, 8),
        run=gs.Settle(max_cycles=500, tolerance=1e-4),
        numerics={"dt": 0.05},
        verify=0,
        out=folder / "wells",
    )
    return folder / "wells"


def test_a_model_without_skeleton_or_feet_shows_its_observables(wells: Path) -> None:
    result = gs.load(wells)
    message = CliRunner().invoke(commands.app, ["explore", str(wells)])
    assert message.exit_code == 0, message.output
    fields = fields_of(wells / "explore.html")
    assert fields["figure"] is None
    assert fields["limbs"] == []
    assert "500 cycles" in fields["statuses"]["cycle_limit"]  # the job's limit
    assert [each["name"] for each in fields["series"]] == ["x"]
    columns = {column["name"]: column for column in fields["columns"]}
    np.testing.assert_allclose(columns["x_end"]["values"], result["x_end"], rtol=1e-6)
    leads = [fields["outcomes"][each]["name"] for each in fields["outcome"]]
    assert leads == list(result["gait"])
    for walk in fields["walks"]:
        row, series = result.iloc[walk["record"]], fields["series"][0]
        whole = numbers_of(walk["crossings"]["values"])
        values = series["low"] + (whole + 32767) / 65534 * (series["high"] - series["low"])
        assert len(values) == row["cycles"] + 1
        # the start and the end; 2^-16 of the range is lost
        np.testing.assert_allclose(values[[0, -1]], [row["x_0"], row["x_end"]], atol=1e-4)


@pytest.mark.slow
def test_a_ramp_that_ends_before_its_first_crossing_has_no_walks(tmp_path: Path) -> None:
    ramp = gs.Ramp(parameter="lean", path=[0.0, 1.0], rate=1e4)
    result = gs.sweep("double_well:DoubleWell", x_0=[-1.0, 0.5], run=ramp, verify=0, out=tmp_path / "short")
    assert set(result.table["crossing"]) == {0}
    fields = fields_of(result.explore())
    assert (len(fields["walks"]), len(fields["outcome"])) == (0, 2)


class Fast(gs.DeclaredModel):
    """A clock with the height of a foot that never lifts off."""

    gaits = ("slow", "fast")
    w = gs.parameter("rad/s", "frequency", 6.0)
    phi = gs.variable("rad", "phase", 0.5, circular=True, observed=False)

    def flow(self, p, s):
        return {"phi": p.w}

    @gs.event("its sine rises", section=True)
    def turns(self, p, s):
        return jnp.sin(s.phi)

    @gs.observable("rad/s", "rate")
    def rate(self, p, s):
        return p.w

    @gs.observable("m", "height")
    def height(self, p, s):
        return jnp.nan * s.phi

    def label(self, p, at):
        return {"gait": jnp.where(at["rate"] > 5.5, 1, 0)}

    def period(self, p):
        return 2.0 * jnp.pi / p.w


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["return_map", "ramp"])
def test_an_unknown_observable_does_not_hide_the_gait(tmp_path: Path, kind: str) -> None:
    ramp = gs.Ramp(parameter="w", path=[5.0, 6.0], rate=0.1)
    axes: dict[str, Any] = {} if kind == "ramp" else {"w": [5.0, 6.0]}
    run = ramp if kind == "ramp" else gs.ReturnMap(crossings=4)
    result = gs.sweep(Fast, run=run, verify=0, out=tmp_path / kind, **axes)
    fields = fields_of(result.explore())
    shown = {fields["outcomes"][number]["name"] for number in fields["outcome"]}
    assert shown == {"slow", "fast"}


def test_a_record_without_numbers_is_failed_and_one_with_an_unknown_observable_is_not() -> None:
    run = {"kind": "ramp", "parameter": "lean", "path": [0.0, 1.0], "rate": 0.1}
    job = gs.Job(name="unknown", model="double_well:DoubleWell", run=run)
    numbers = {"t": [0.0, 1.0, np.nan], "lean": [0.0, 0.1, 0.2], "x_n": np.nan}
    table = pd.DataFrame({"row": [0, 0, 1], "crossing": [0, 1, 0], **numbers, "status": "complete"})
    shown = map_of(table.assign(gait="left"), job, "lean", "crossing", 100)
    assert [shown.outcomes[number]["name"] for number in shown.outcome] == ["left", "left", "failed"]


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [[0.0], [0.0, 4.0]])
def test_a_row_without_a_nominal_period_is_shown(tmp_path: Path, stiffness: list[float]) -> None:
    hold = gs.FixedTime(duration=3.0)
    with pytest.warns(UserWarning, match="period"):
        result = gs.sweep("smooth_oscillators:Spring", k=stiffness, run=hold, verify=0, out=tmp_path / "out")
    assert result.table["status"].iloc[0] == "not_a_number"
    assert len(fields_of(result.explore())["walks"]) == len(stiffness)


@pytest.mark.slow
def test_the_walks_of_a_ramp_do_not_depend_on_the_order_of_records(tmp_path: Path) -> None:
    ramp = gs.Ramp(parameter="lean", path=[0.0, 1.0], rate=0.05)
    out = tmp_path / "ramp"
    result = gs.sweep("double_well:DoubleWell", numerics={"dt": 0.05}, run=ramp, verify=0, out=out)
    mixed: Any = result.table.sample(frac=1.0, random_state=0)
    crossings = []
    for shown in (result, Result(table=mixed)):
        fields = fields_of(shown.explore(tmp_path / "page.html", replays=4))
        columns = {column["name"]: column["values"] for column in fields["columns"]}
        crossings.append([columns["crossing"][walk["record"]] for walk in fields["walks"]])
    assert crossings[0] == crossings[1] == [100, 200, 300, 400]


@pytest.mark.slow
def test_a_row_of_a_map_has_its_last_gait_whatever_the_order_of_records(tmp_path: Path) -> None:
    cross = gs.ReturnMap(crossings=99)
    model = "double_well:DoubleWell"
    result = gs.sweep(model, x_0=[-0.01], lean=1.0, run=cross, verify=0, out=tmp_path / "map")
    assert result.table["x_n"].iloc[[0, -1]].gt(0.0).tolist() == [False, True]
    for table in (result.table, result.table.iloc[::-1]):
        fields = fields_of(Result(table=table).explore(tmp_path / "page.html"))
        assert {fields["outcomes"][number]["name"] for number in fields["outcome"]} == {"right"}


def test_a_map_of_more_slices_than_records_has_points() -> None:
    vary = {"k": {"linspace": [1.0, 2.0, 150]}, "x_0": [0.0, 1.0], "v_0": [2.0, 3.0]}
    job = gs.Job(
        name="slices",
        model="smooth_oscillators:Spring",
        run={"kind": "fixed_time", "duration": 1.0},
        vary=vary,
    )
    table = table_of(job).assign(gait="none")
    shown = {most: map_of(table, job, "x_0", "v_0", most) for most in (700, 200, 100)}
    assert {most: (each.kind, len(each.table)) for most, each in shown.items()} == {
        700: ("cells", 600),
        200: ("cells", 150),
        100: ("points", 100),
    }


@pytest.mark.slow
def test_no_more_records_walk_than_are_asked_for(tmp_path: Path) -> None:
    stairs = gs.Staircase(parameter="lean", path=[0.0, 1.0], step=0.5, dwell=9.0)
    ramp = gs.Ramp(parameter="lean", path=[0.0, 1.0], rate=0.05)
    for run in (stairs, ramp):
        out = tmp_path / run.kind_name
        numerics = {"dt": 0.05}
        result = gs.sweep("double_well:DoubleWell", numerics=numerics, run=run, verify=0, out=out)
        assert len(fields_of(result.explore(replays=1))["walks"]) == 1


class SilentHopper(Hopper):
    """A hopper that has no signals."""

    @property
    def signals(self) -> tuple[Quantity, ...]:
        return ()


@pytest.mark.slow
def test_rows_of_a_model_without_signals_walk(tmp_path: Path) -> None:
    result = gs.sweep(SilentHopper(), launch_0=[2.5, 5.0], phase_0=2.0, verify=0)
    fields = fields_of(result.explore(tmp_path / "page.html"))
    assert len(fields["walks"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("run", [gs.Settle(), gs.FixedTime(duration=9.3)], ids=lambda run: run.kind_name)
def test_rows_that_repeat_the_table_do_not_differ(run: Any, tmp_path: Path) -> None:
    """A hopper on an orbit of three crossings, of which the table has the same one in all rows."""
    phases = np.linspace(0.1, 6.0, 12).tolist()
    result = gs.sweep(Hopper(), run=run, launch_0=1.0, phase_0=phases, verify=0)
    fields = fields_of(result.explore(tmp_path / "page.html"))
    assert len(fields["walks"]) == len(phases)
    assert not any({"apart", "share", "later"} & set(walk) for walk in fields["walks"])


@pytest.mark.parametrize(
    ("phase", "launch", "told"),
    [(2.0 * np.pi - 1e-3, 3.0, {}), (0.5, 3.0, {"apart": 0.5}), (0.0, 3.5, {"share": 0.25})],
)
def test_an_observable_of_any_unit_that_differs_from_the_table_is_told(
    phase: float, launch: float, told: dict[str, float]
) -> None:
    """Launches in the table are from 2 to 4 m/s; the nearest of the last two crossings counts."""
    table = pd.DataFrame({"phase_end": [0.0, 0.0], "launch_end": [3.0, 2.0]})
    table.loc[2] = [0.0, 4.0]
    observed = np.array([[0.0, 9.0], [phase, launch], [3.0, 9.0]])
    stub = SimpleNamespace(_table=table, _model=Hopper())
    replayed = SimpleNamespace(crossings=SimpleNamespace(number=range(3), observed=observed))
    result = AnimatedRecords._largest_change(stub, 0, replayed, range(1, 3), "end")  # type: ignore[arg-type]
    assert result == pytest.approx(told)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "x", "y"),
    [
        ({"kind": "return_map", "crossings": 60}, "x_n", "x_n_change"),
        ({"kind": "ramp", "parameter": "lean", "path": [0.0, 1.0], "rate": 0.05}, "lean", "x_n"),
        (
            {
                "kind": "staircase",
                "parameter": "lean",
                "path": [0.0, 1.0, 0.5],
                "step": 0.2,
                "dwell": 9.0,
                "tolerance": 1e-9,
            },
            "lean",
            "x_n",
        ),
    ],
)
def test_records_of_rows_walk(tmp_path: Path, run: dict[str, Any], x: str, y: str) -> None:
    """Each record that walks shows its own crossing among those of its row."""
    job = gs.Job(
        name="records", model="double_well:DoubleWell", verify=0, numerics={"dt": 0.05}, run=run,
        vary={"x_0": [-1.0, 0.5]},
    )  # fmt: skip
    result = gs.run(job, tmp_path / "records")
    fields, table = fields_of(result.explore(replays=20)), result.table
    assert (fields["x"]["name"], fields["y"]["name"]) == (x, y)
    columns = {column["name"]: column["values"] for column in fields["columns"]}
    if y == "x_n_change":
        change = table.groupby("row")["x_n"].diff().dropna()
        np.testing.assert_allclose(columns[y], change, rtol=1e-6)
        assert fields["noChange"] == 0.0
    else:
        np.testing.assert_allclose(columns[y], table[y], rtol=1e-6)
    assert fields["walks"]
    if run["kind"] == "staircase":
        assert [each["rises"] for each in fields["passes"]] == [True, False]
        assert len({(each["colour"], each["marker"]) for each in fields["passes"]}) == 2
        assert columns["settled"][fields["first"]] == 1
        assert columns["settled"][1] == 0  # the second stair, which has not settled
    else:
        assert fields["passes"] == []
    for walk in fields["walks"]:
        series = fields["series"][0]
        whole = numbers_of(walk["crossings"]["values"])
        values = series["low"] + (whole + 32767) / 65534 * (series["high"] - series["low"])
        own = columns["x_n"][walk["record"]]
        place = -1 if y == "x_n" else columns["crossing"][walk["record"]] - walk["crossings"]["first"]
        assert values[place] == pytest.approx(own, abs=1e-4)


@pytest.mark.slow
def test_points_of_a_branch_walk_one_cycle(tmp_path: Path) -> None:
    """The bouncing mass on a branch: a flight takes the time of the closed form, and returns."""
    job = gs.Job(
        name="hops", model="toy_model:Toy", vary={"stiffness": [4.0, 9.0]}, verify=0,
        run={"kind": "continuation", "parameter": "restitution", "path": [0.2, 0.8], "settle": 5},
        numerics={"method": "rk4", "dt": 1e-2},
    )  # fmt: skip
    result = gs.run(job, tmp_path / "hops")
    fields, table = fields_of(result.explore()), result.table
    assert len(fields["walks"]) == len(table)
    series = fields["series"][0]
    for walk in fields["walks"]:
        row, (motion,) = table.iloc[walk["record"]], walk["motions"]
        assert motion["loops"]
        length = (motion["samples"] - 1) * motion["sample"]
        exact = float(flight_time(row["launch_1_n"], math.sqrt(row["stiffness"]), 0.5))
        assert length == pytest.approx(exact, abs=motion["stride"] * motion["sample"])
        whole = numbers_of(walk["crossings"]["values"])
        values = series["low"] + (whole + 32767) / 65534 * (series["high"] - series["low"])
        np.testing.assert_allclose(values[:2], row["launch_1_n"], atol=1e-4)


NO_BROWSER = pytest.mark.skipif(
    program() is None, reason="no Chromium on this machine (apt-get install chromium)"
)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result, with its page, of a model whose texts a page could take for HTML; some rows fall."""
    folder = tmp_path_factory.mktemp("hostile") / "hostile"
    job = gs.Job(
        name="hostile", model="hostile_texts:HostileTexts", verify=0, numerics={"dt": 0.05},
        vary={"x_0": {"linspace": [-1.6, 1.6, 9]}, "lean": [0.0, 0.5]},
        run={"kind": "settle", "max_cycles": 200},
    )  # fmt: skip
    gs.run(job, folder).explore()
    return folder


def test_texts_of_a_model_are_no_html(hostile: Path) -> None:
    fields = fields_of(hostile / "explore.html")
    shown = [fields["x"]["label"], fields["y"]["label"], *(each["group"] for each in fields["series"])]
    shown += [each["symbol"] for each in (*fields["columns"], *fields["series"])]
    for text in shown:
        assert not re.search(r"<(?!/?su[bp]>)", text), text
    assert len({each["group"] for each in fields["series"]}) == 2  # m and m/s
    assert ATTACK not in (hostile / "explore.html").read_text()


@pytest.mark.slow
@NO_BROWSER
def test_a_page_shows_texts_as_they_are(hostile: Path) -> None:
    """Quotes, tags and ends of scripts in what a model says; rows that fell; groups of observables."""
    with browser() as page:
        for width in (1280, 390):
            page.size(width, 900)
            page.open(hostile / "explore.html", "#row=4")
            assert page.evaluate("window.taken") is None
            assert page.errors == []
            assert (
                page.evaluate("document.querySelectorAll('main img, main u, main i, main script').length")
                == 0
            )
            message = page.evaluate("document.body.innerText")
            for text in (ATTACK, HostileTexts.gaits[1], "m/s<sup>2", HostileTexts.source):
                assert text in message, text
            # plotly.js reads the same texts: the start's symbol and its unit, the observable's symbol
            assert 'x<0 (m"<u>)' in page.evaluate("document.getElementById('map').textContent")
            assert f"x{ATTACK}" in page.evaluate("document.querySelector('#phases .legend').textContent")
            # observables of another unit are a click away
            names = page.evaluate("[...document.querySelectorAll('#groups button')].map(b => b.textContent)")
            assert len(names) == 2
            drawn = "document.getElementById('phases').data.map(each => each.y.length)"
            unit = "document.getElementById('phases').layout.yaxis.title.text"
            assert page.evaluate(drawn)[0] > 1
            before = page.evaluate(unit)
            page.evaluate("document.querySelectorAll('#groups button')[1].click()")
            assert page.evaluate(unit) == "m/s" != before
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        # a row that fell says so, and walks to where it did
        fell = next(row for row in gs.load(hostile).to_dict("records") if row["status"] == "fell")
        page.open(hostile / "explore.html", f"#row={fell['row']}")
        assert "fell" in page.evaluate("document.getElementById('ended').textContent")
        assert page.errors == []


def python_of(fields: dict[str, Any], record: int) -> str:
    """What the button `Copy Python` copies, as the page's function pythonOf makes it."""
    columns = {each["name"]: each["values"] for each in fields["columns"]}
    columns = {
        name: values[record] if isinstance(values, list) else values for name, values in columns.items()
    }
    values = ", ".join(f"{json.dumps(name)}: [{columns[name]!r}]" for name in fields["varied"])
    return fields["python"].replace("@row@", str(columns["row"])).replace("@vary@", values)


@pytest.mark.slow
def test_the_copied_python_is_the_row(
    logarithmic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It runs as it is, and gives the row's record to the last bit."""
    monkeypatch.chdir(tmp_path)
    row, scope = 23, dict[str, Any]()
    exec(python_of(fields_of(logarithmic / "explore.html"), row), scope)
    assert scope["job"].name == f"springs_row_{row}"
    table, found = gs.load(logarithmic), gs.load(tmp_path / "results" / f"springs_row_{row}")
    for name in ("launch_1", "stiffness", "launch_1_end", "t_end", "gait"):
        assert found[name].iloc[0] == table[name].iloc[row]


# Clicks everything that answers to a click, and chooses each value of each list; returns what was clicked.
CLICKS = """(async () => {
  const clicked = [];
  for (const element of document.querySelectorAll('button, a, select, input, .modebar-btn, #map')) {
    if (!element.isConnected) continue;  // a choice before it has replaced it
    clicked.push(element.getAttribute('data-title') || element.textContent.trim() || element.id);
    element.dispatchEvent(new MouseEvent('click', { bubbles: true, cancelable: true }));
    for (const option of element.options || []) {
      element.value = option.value;
      element.dispatchEvent(new Event('change', { bubbles: true }));
    }
    await new Promise(done => setTimeout(done, 60));
  }
  await new Promise(done => setTimeout(done, 500));
  return clicked;
})()"""


@pytest.mark.slow
@NO_BROWSER
def test_no_control_of_a_page_reaches_out(hostile: Path, logarithmic: Path, wells: Path) -> None:
    """Each control is clicked: no request, no new window, no message of the console."""
    gs.load(wells)
    Result(wells).explore()
    with browser() as page:
        page.size(1280, 900)
        for folder in (hostile, logarithmic, wells):
            page.open(folder / "explore.html")
            clicked = page.evaluate(CLICKS)
            assert {"Zoom in", "play", "pause"} & set(clicked), clicked
            assert not [each for each in clicked if re.search("share|cloud|upload", each, re.IGNORECASE)]
            assert all(request.startswith(("file:", "data:", "blob:")) for request in page.requests)
            assert sum(request.startswith("file:") for request in page.requests) == 1
            assert page.windows == []
            assert page.messages == []
            assert page.errors == []


def test_no_control_of_a_page_can_reach_out() -> None:
    """Buttons of plotly.js are those of a list, in each figure; no part of the page names another place."""
    page = Path(view.__file__).parent / "explorer" / "page"
    parts = [path.read_text() for path in page.iterdir()]
    script = "\n".join(path.read_text() for path in sorted(page.glob("*.js")))
    (buttons,) = re.findall(r"^const BUTTONS = (.*);$", script, re.MULTILINE)
    stays = {"toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"}
    assert {each for row in json.loads(buttons) for each in row} == stays
    calls = re.findall(r"Plotly\.(?:react|newPlot)\(.*?\);$", script, re.MULTILINE | re.DOTALL)
    assert len(calls) == script.count("Plotly.react(") + script.count("Plotly.newPlot(") == 3
    assert all("{ ...NO_UPLOAD, " in call for call in calls)
    (options,) = re.findall(r"^const NO_UPLOAD = \{(.*)\};$", script, re.MULTILINE)
    for option in ("modeBarButtons: BUTTONS", "showSendToCloud: false", 'plotlyServerURL: ""'):
        assert option in options
    for part in parts:
        assert not re.search(r"https?:|window\.open|fetch\(|XMLHttpRequest|sendBeacon|WebSocket|<form", part)
    policy = next(part for part in parts if "Content-Security-Policy" in part)
    for rule in ("default-src 'none'", "form-action 'none'", "base-uri 'none'"):
        assert rule in policy


@pytest.mark.slow
@NO_BROWSER
def test_a_page_of_one_record(tmp_path: Path) -> None:
    """One row; one row that failed; a whole table that failed."""
    for number, starts in enumerate(([0.5], [1.6], [-1.6, 1.6])):
        job = gs.Job(
            name="few", model="hostile_texts:HostileTexts", verify=0, numerics={"dt": 0.05},
            vary={"x_0": starts}, run={"kind": "settle", "max_cycles": 200},
        )  # fmt: skip
        file = gs.run(job, tmp_path / f"few{number}").explore()
        with browser() as page:
            page.size(1280, 900)
            page.open(file, "#row=0")
            assert page.evaluate("document.querySelector('td[data-column=row]').textContent") == "0"
            for key in ("ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "e", " "):
                page.press(key)
            assert page.errors == []
            assert page.evaluate("document.querySelector('td[data-column=row]').textContent") == "0"


def test_numbers_that_json_lacks_are_texts() -> None:
    table = pd.DataFrame({"a": [math.nan, math.inf, -math.inf, 1e-12]})
    (column,) = columns_of(table)
    assert column["values"] == [None, "inf", "-inf", 1e-12]
    json.dumps(column, allow_nan=False)


@pytest.mark.parametrize("kind", ["Int64", "Float64", "boolean"])
def test_missing_numbers_of_nullable_columns_are_none(kind: str) -> None:
    (column,) = columns_of(pd.DataFrame({"a": pd.array([1, None], dtype=kind)}))
    assert column["values"] == [1, None]


@pytest.mark.slow
@NO_BROWSER
def test_a_value_without_rows_and_keys_beside_the_map(tmp_path: Path) -> None:
    """A table that lacks all rows of a value: the page says so, and stays where it is; keys go on."""
    job = gs.Job(
        name="part", model="toy_model:Toy", verify=0, params={"ceiling": 5.0},
        vary={
            "restitution": [0.3, 0.5, 0.9],
            "launch_1": {"linspace": [0.5, 6.0, 6]},
            "stiffness": {"linspace": [0.5, 9.0, 6]},
        },
        run={"kind": "settle", "max_cycles": 40},
    )  # fmt: skip
    table = gs.run(job, tmp_path / "part").table
    part = table.loc[table["restitution"] < 0.8]
    part.attrs = table.attrs
    file = write_explorer(part, tmp_path / "part.html")
    with browser() as page:
        page.size(1280, 900)
        page.open(file, "#row=0")
        row = "Number(document.querySelector('td[data-column=row]').textContent)"
        page.evaluate("document.querySelectorAll('#slices button')[2].click()")
        assert "= 0.9 has ended yet" in page.evaluate("document.getElementById('elsewhere').textContent")
        assert page.evaluate(row) == 0
        pressed = "[...document.querySelectorAll('#slices button')].map(b => b.getAttribute('aria-pressed'))"
        assert page.evaluate(pressed) == ["true", "false", "false"]
        # the choice of a value keeps the keyboard's place, and arrows move on from there
        page.evaluate("document.querySelectorAll('#slices button')[1].click()")
        page.wait(f"{row} === 36")
        assert page.evaluate("document.activeElement.textContent").endswith("0.5")
        page.press("ArrowRight")
        page.wait(f"{row} === 37")
        assert page.errors == []


@pytest.fixture(scope="module")
def logarithmic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bouncing masses over a spring that varies in equal ratios, with their page."""
    folder = tmp_path_factory.mktemp("logarithmic") / "springs"
    job = gs.Job(
        name="springs", model="toy_model:Toy", verify=0, params={"ceiling": 5.0, "restitution": 0.9},
        vary={"launch_1": {"linspace": [0.5, 6.0, 6]}, "stiffness": {"logspace": [0.5, 200.0, 9]}},
        run={"kind": "settle", "max_cycles": 40},
        figures=[{"kind": "basin", "x": "stiffness", "y": "launch_1"}],
    )  # fmt: skip
    gs.run(job, folder).explore(replays=0)
    return folder


def test_axes_are_logarithmic_as_in_the_figure(logarithmic: Path) -> None:
    fields, table = fields_of(logarithmic / "explore.html"), gs.load(logarithmic)
    assert (fields["kind"], fields["x"]["log"], fields["y"]["log"]) == (CELLS, True, False)
    edges = np.array(fields["edges"][0])
    ratio = (200.0 / 0.5) ** (1 / 8)
    np.testing.assert_allclose(edges[1:] / edges[:-1], ratio, rtol=1e-6)
    figure = gs.plot.basin(table, x="stiffness", y="launch_1")
    axes = figure.axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    np.testing.assert_allclose(axes.get_xlim(), edges[[0, -1]], rtol=1e-6)


@pytest.mark.slow
@NO_BROWSER
def test_a_click_on_a_logarithmic_map(logarithmic: Path, tmp_path: Path) -> None:
    """Cells are equally wide, a click chooses the start under it, its mark is around it."""
    table = gs.load(logarithmic)
    with browser() as page:
        page.size(1280, 900)
        page.open(logarithmic / "explore.html", "#row=0")
        axis = "document.getElementById('map')._fullLayout.xaxis"
        places = page.evaluate(f"{sorted(set(table['stiffness']))}.map(v => {axis}.d2p(v))")
        np.testing.assert_allclose(np.diff(places), np.diff(places).mean(), rtol=1e-6)
        row = 3 * 9 + 6
        start = table.iloc[row]
        box = page.evaluate(
            "(() => { const b = document.querySelector('#map .nsewdrag').getBoundingClientRect();"
            " return [b.left, b.top]; })()"
        )
        y = page.evaluate(f"document.getElementById('map')._fullLayout.yaxis.d2p({start['launch_1']})")
        page.click(box[0] + places[6], box[1] + y)
        page.wait(f"document.querySelector('td[data-column=row]').textContent === '{row}'")
        # the mark's edges in pixels: half a cell to both sides of its middle
        edges = page.evaluate(
            f"(() => {{ const s = document.getElementById('map')._fullLayout.shapes.at(-1);"
            f" return [s.x0, s.x1].map(v => {axis}.d2p(v)); }})()"
        )
        np.testing.assert_allclose(np.mean(edges), places[6], atol=0.01)
        drawn = page.evaluate(
            "(() => { const all = document.querySelectorAll('#map .shapelayer path');"
            " const b = all[all.length - 1].getBoundingClientRect(); return [b.left, b.right]; })()"
        )
        np.testing.assert_allclose(np.array(drawn) - box[0], edges, atol=3.0)  # half the line's width
        assert page.errors == []
        # of points the mark is a circle around the chosen one
        points = write_explorer(table, tmp_path / "points.html", x="stiffness", y="launch_1_end", replays=0)
        page.open(points, f"#row={row}")
        assert page.evaluate("[data.kind, data.x.log, data.y.log]") == ["points", True, False]
        middle = page.evaluate(
            "(() => { const { xaxis: x, yaxis: y } = document.getElementById('map')._fullLayout;"
            f" return [x.d2p({start['stiffness']}), y.d2p({start['launch_1_end']})]; }})()"
        )
        ring = page.evaluate(
            "(() => { const all = document.querySelectorAll('#map .shapelayer path');"
            " const a = document.querySelector('#map .nsewdrag').getBoundingClientRect();"
            " const b = all[all.length - 1].getBoundingClientRect();"
            " return [(b.left + b.right) / 2 - a.left, (b.top + b.bottom) / 2 - a.top,"
            " b.width, b.height]; })()"
        )
        np.testing.assert_allclose(ring[:2], middle, atol=0.1)
        np.testing.assert_allclose(ring[2:], 20.0, atol=3.0)  # twice its radius, and the line's width
        assert page.errors == []


@pytest.mark.slow
@NO_BROWSER
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_of_the_page_have_contrast(
    hostile: Path, logarithmic: Path, scheme: str, tmp_path: Path
) -> None:
    """At least 4.5 : 1 (WCAG 2.2, AA), on HTML, on figures of plotly.js and on canvases."""
    walked = Result(logarithmic).explore(tmp_path / "walked.html")
    with browser() as page:
        page.scheme(scheme)
        for file in (hostile / "explore.html", walked):
            for width in (1280, 390):
                page.size(width, 900)
                page.open(file, "#row=4")
                assert page.least_contrast() >= (4.5, "")
        _check_canvases(page, scheme)
        # another scheme is followed at once
        page.scheme({"light": "dark", "dark": "light"}[scheme])
        page.wait(f"shade !== SCHEMES.{scheme}")
        for figure in ("map", "phases"):
            page.wait(f"document.getElementById('{figure}').layout?.paper_bgcolor === shade.paper")
        assert page.least_contrast() >= (4.5, "")


def _check_canvases(page: Page, scheme: str) -> None:
    """The colours of texts on canvases, and of lines and markers of figures."""
    assert page.evaluate(f"shade === SCHEMES.{scheme}")
    contrast = (
        "(a, b) => { const long = c => c.length === 4 ? c.replace(/[^#]/g, '$&$&') : c;"
        " const [p, q] = [a, b].map(c => luminance(long(c))).sort((p, q) => q - p);"
        " return (p + 0.05) / (q + 0.05); }"
    )
    for text, behind in (("ink", "paper"), ("faint", "paper"), ("length", "strip")):
        assert page.evaluate(f"({contrast})(shade.{text}, shade.{behind})") >= 4.5, (text, behind)
    if scheme == "dark":
        for colour in ("#3B3B3B", "#000000", *theme.SPARE_COLOURS):
            assert page.evaluate(f"({contrast})(visible('{colour}'), shade.paper)") >= 3.0, colour


@pytest.mark.slow
@NO_BROWSER
def test_a_page_of_ten_thousand_cells_is_shown_before_its_map_answers(tmp_path: Path) -> None:
    """What does not need the map is not held up by it; `python -m benchmarks.explorer` has the times."""
    job = gs.Job(
        name="many", model="toy_model:Toy", verify=0, params={"ceiling": 5.0, "restitution": 0.3},
        vary={"launch_1": {"linspace": [0.5, 6.0, 100]}, "stiffness": {"linspace": [0.5, 20.0, 100]}},
        run={"kind": "settle", "max_cycles": 40},
    )  # fmt: skip
    file = gs.run(job, tmp_path / "many").explore()
    with browser() as page:
        page.size(1280, 900)
        page.open(file)
        shown, ready = (
            int(page.evaluate(f"document.documentElement.dataset.{each}")) for each in ("shown", "ready")
        )
        assert shown < ready
        assert page.errors == []


def test_what_is_not_recognised_of_plotly_stays() -> None:
    """All kinds of traces but one are left out of a program built as plotly.js is, and of no other."""
    modules = (
        'var A=W((q,r)=>{"use strict";r.exports=B()});'
        'var B=W((q,r)=>{"use strict";r.exports={name:"heatmap"}});'
        'var C=W((q,r)=>{"use strict";r.exports=D()});'
        'var D=W((q,r)=>{"use strict";r.exports={name:"cone"}});'
    )
    built = f'{modules}K.register([A(),C()]);x="年"'
    assert fast_to_load(built) == built.replace("A(),C()", "A()").replace("年", "\\u5e74")
    other = built.replace("heatmap", "cone")
    assert fast_to_load(other) == other.replace("年", "\\u5e74")
    assert fast_to_load('f("𝒙")') == 'f("\\ud835\\udc99")'


@pytest.mark.slow
def test_what_cannot_be_explored_is_refused_in_a_sentence(wells: Path, monkeypatch: Any) -> None:
    def said(*options: str) -> str:
        message = CliRunner().invoke(commands.app, ["explore", str(wells), *options])
        assert message.exit_code != 0
        return str(message.exception)

    assert "is not a column of this table" in said("--x", "x_00")
    assert "Both axes would be x_0" in said("--x", "x_0", "--y", "x_0")
    assert "max_size is 0.5 MB" in said("--max-size", "0.5")
    for size in ("nan", "inf", "0"):
        assert f"max_size is {size} MB, but must be a finite number above 0" in said("--max-size", size)
    for option in ("--replays", "--walks"):
        assert "replays is -1, but must be 0 or more" in said(option, "-1")
    job = gs.Job(
        name="trace", model="double_well:DoubleWell", verify=0,
        run={"kind": "trace", "duration": 1.0, "every": 0.1},
    )  # fmt: skip
    trace = Result(table=table_of(job))
    with pytest.raises(gs.ArgumentError, match="trace rows"):
        trace.explore("nowhere.html")
    mapped: Any = table_of(job.model_copy(update={"run": gs.ReturnMap(crossings=2)}))
    with pytest.raises(gs.ArgumentError, match="No row has x_n at two successive crossings"):
        Result(table=mapped[mapped["crossing"] == 0]).explore("nowhere.html")
    without_job = trace.table.copy()
    without_job.attrs = {}
    with pytest.raises(gs.ArgumentError, match="has no job"):
        Result(table=without_job).explore("nowhere.html")
    with pytest.raises(gs.ArgumentError, match="in memory"):
        trace.explore()
    known = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "plotly" else known(name))
    with pytest.raises(MissingPackageError, match=r"pip install 'gaitsweep\[explore\]'") as refused:
        Result(wells).explore()
    assert refused.value.exit_code == 2


@pytest.fixture(scope="module")
def basins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Basins of the four-legged chain on a coarse grid, with its page."""
    folder = tmp_path_factory.mktemp("basins") / "chain"
    axis = {"linspace": [0, "2*pi", SIDE], "at": "centre"}
    job = gs.Job(
        name="chain", model="multilegged", structure={"N": 3}, verify=0,
        vary={"psi_3": list(PSI_3), "psi_2": axis, "psi_1": axis},
        run={"kind": "settle", "max_cycles": 120},
        figures=[{"kind": "basin", "x": "psi_1", "y": "psi_2", "panels": "psi_3"}],
    )  # fmt: skip
    gs.run(job, folder).explore()
    return folder


@pytest.mark.slow
def test_walks_are_those_of_the_same_starts(basins: Path) -> None:
    table, fields = gs.load(basins), fields_of(basins / "explore.html")
    assert fields["kind"] == CELLS
    assert len(fields["walks"]) == len(table) == 2 * SIDE**2
    model = gs.models.Multilegged(N=3)
    for walk in fields["walks"][::9]:
        row = table.iloc[walk["record"]]
        first, last = walk["motions"]
        assert (first["name"], last["name"]) == ("the first cycles", "the gait")
        length = (first["samples"] - 1) * first["sample"]
        start: dict[str, Any] = {name: float(row[name]) for name in ("psi_1", "psi_2", "psi_3")}
        alone = gs.simulate(model, **start, duration=length * (1.0 + 1e-9), every=first["sample"])
        signals = {name: alone[name].to_numpy(float) for name in map(str, alone.columns)}
        # contacts are those of each sample
        for leg, turns in enumerate(first["contact"]):
            down = np.zeros(len(alone), bool)
            for begin, end in zip(turns[::2], turns[1::2], strict=True):
                down[begin:end] = True
            np.testing.assert_array_equal(down, signals[f"contact_{leg + 1}"] > 0.5)
        # the legs are where the skeleton of the same motion has them, to a thousandth of the height
        drawn = {name: values[:: first["stride"]] for name, values in signals.items()}
        skeleton = model.skeleton({q.name: q.default for q in model.parameters} | {"L": 1.0}, drawn)
        assert skeleton is not None
        t = drawn["t"]
        clip = Clip(t, skeleton, t, np.zeros((len(t), 0)), 1.0, "")
        middle = np.column_stack([clip.camera, np.zeros(len(t))])[:, None, :]
        legs = np.concatenate([projected(limb.points - middle) for limb in skeleton.limbs], axis=1)
        result = points_of(first)[:, : legs.shape[1] * 2]
        np.testing.assert_allclose(result, legs.reshape(len(t), -1), atol=0.51 * first["unit"] + 1e-9)
        # the last crossing is where the table says that the row settled
        for series in fields["series"]:
            whole = numbers_of(walk["crossings"]["values"]).reshape(len(fields["series"]), -1)
            ends = whole[fields["series"].index(series), -1]
            value = series["low"] + (ends + 32767) / 65534 * (series["high"] - series["low"])
            apart = abs(value - row[f"{series['name']}_end"])
            assert min(apart, 2 * math.pi - apart) < 2e-4  # 2^-16 of a turn, and the steps cut by samples


def nearest_elsewhere(table: pd.DataFrame, row: int) -> float:
    """The distance in cells to the nearest start of the same psi_3 with another gait, by trying all."""
    mine = table.iloc[row]
    best = math.inf
    for _, other in table.iterrows():
        if other["psi_3"] == mine["psi_3"] and other["gait"] != mine["gait"]:
            apart = [abs(round((other[n] - mine[n]) / (2 * math.pi / SIDE))) for n in ("psi_1", "psi_2")]
            best = min(best, math.hypot(*(min(each, SIDE - each) for each in apart)))
    return best


def _check_chain(page: Page) -> None:
    """Legs in swing have their colour, alone; the lift of feet can be exaggerated; the wave is drawn."""
    page.evaluate("play(false)")
    orange = (
        "(() => { const pen = document.getElementById('%s').getContext('2d');"
        " const { data } = pen.getImageData(0, 0, 3000, 600);"
        " let n = 0; for (let k = 0; k < data.length; k += 4)"
        " n += data[k] === 213 && data[k + 1] === 94 && data[k + 2] === 0; return n; })()"
    )
    counts = {True: [], False: []}
    for part in range(20):
        page.evaluate(f"clock.at = {part} / 20 * lengthOf(motion); paint()")
        swings = page.evaluate("data.limbs.some((_, k) => !isOnGround(motion, k, clock.at))")
        counts[swings].append(page.evaluate(orange % "body"))
        if swings:
            heights = "withLiftedFeet(motion, bodyAt(motion, clock.at, 0).points)"
            low = page.evaluate(heights)
            page.evaluate("document.getElementById('lift').value = '3'")
            high = page.evaluate(heights)
            page.evaluate("document.getElementById('lift').value = '1'")
            feet = [4 * leg + 3 for leg in range(4)]
            grounds = [page.evaluate(f"motion.lowest[{foot}]") for foot in feet]
            raised = [ground + 3.0 * (low[foot] - ground) for foot, ground in zip(feet, grounds, strict=True)]
            np.testing.assert_allclose([high[foot] for foot in feet], raised)
    assert min(counts[True]) > 20
    assert set(counts[False]) <= {0}
    assert page.evaluate(orange % "footfalls") > 20


@pytest.mark.slow
@NO_BROWSER
@pytest.mark.parametrize("both", [False, True])
def test_a_motion_is_saved_as_a_gif(basins: Path, tmp_path: Path, both: bool) -> None:
    """A reader of GIFs finds the pictures and the times of the page's stretch, and a body that moves."""
    with browser() as page:
        page.size(1280, 900)
        page.open(basins / "explore.html", "#row=3")
        page.evaluate("play(false)")
        if both:
            page.evaluate("document.getElementById('compare').click()")
        file = page.downloaded(tmp_path, "document.getElementById('save-gif').click()")
        told = page.wait("/saved/.test($('copied').textContent) && $('copied').textContent")
        seconds, loops = page.evaluate("[lengthOf(motion) / clock.speed, motion.loops]")
        size, paper = page.evaluate("GIF_SIZE"), page.evaluate("shade.paper")
        assert all(each.startswith(("file:", "data:", "blob:")) for each in page.requests)
        assert page.windows == page.messages == page.errors == []
    assert file.suffix == ".gif"
    assert file.stem.startswith("chain_row_3")
    assert f"{file.stat().st_size / 1e6:.1f} MB" in told
    with PIL.Image.open(file) as gif:
        assert gif.n_frames > 20  # type: ignore[attr-defined]
        pictures, durations = [], []
        for picture in PIL.ImageSequence.Iterator(gif):
            pictures.append(np.asarray(picture.convert("RGB"), int))
            durations.append(picture.info["duration"] / 1000.0)
    assert sum(durations) == pytest.approx(seconds + (0.0 if loops else 0.6), abs=2 * durations[0])
    assert pictures[0].shape[1] == (2 if both else 1) * size[0]
    assert (pictures[0][-1, -1] == PIL.ImageColor.getrgb(paper)).all()
    changed = [np.abs(after - before).max(axis=2) > 30 for before, after in itertools.pairwise(pictures)]
    halves = [slice(None, size[0]), slice(size[0], None)] if both else [slice(None)]
    for half in halves:  # each body moves, but for where all its legs stand, and the line above it does not
        assert np.mean([each[-size[1] :, half].any() for each in changed]) > 0.5
    assert not any(each[: -size[1]].any() for each in changed)


@pytest.mark.slow
@NO_BROWSER
def test_the_page_in_a_browser(basins: Path, tmp_path: Path) -> None:
    table = gs.load(basins)
    with browser() as page:
        page.size(1280, 900)
        page.open(basins / "explore.html", "#row=3")
        chosen = "Number(document.querySelector('td[data-column=row]').textContent)"

        def shown(column: str) -> str:
            return page.evaluate(f"document.querySelector('td[data-column={column}]').textContent")

        def at(psi_1: float, psi_2: float) -> tuple[float, float]:
            """Position of a start in the window."""
            place = page.evaluate(
                "(() => { const box = document.querySelector('#map .nsewdrag').getBoundingClientRect();"
                " const { xaxis: x, yaxis: y } = document.getElementById('map')._fullLayout;"
                f" return [box.left + x.d2p({psi_1}), box.top + y.d2p({psi_2})]; }})()"
            )
            return place[0], place[1]

        assert page.evaluate(chosen) == 3
        # a click on a cell chooses its row, whose numbers are those of the table
        row = int(np.flatnonzero(table["psi_3"] == PSI_3[0])[2 * SIDE + 4])
        start = table.iloc[row]
        page.click(*at(start["psi_1"], start["psi_2"]))
        page.wait(f"{chosen} === {row}")
        for column in map(str, table.columns):
            message = shown(column).replace("−", "-").split(" ")[0]
            value = start[column]
            if isinstance(value, float) and not math.isnan(value):
                assert float(message) == pytest.approx(value, rel=1e-6), column
            elif isinstance(value, str) and value:
                assert message == value.split(" ")[0]
        assert page.evaluate("location.hash") == f"#row={row}"
        ended = page.evaluate("document.getElementById('ended').textContent")
        assert str(start["gait"]) in ended
        assert ("at a fixed point" in ended) == (start["attractor_period"] == 1)
        assert "or repeats" not in ended
        # the nearest start that leads elsewhere, by the link and by its key
        text = page.evaluate("document.getElementById('elsewhere').textContent")
        distance = re.search(r"([\d.]+) cells? away", text)
        assert distance is not None
        assert float(distance[1]) == pytest.approx(nearest_elsewhere(table, row), abs=0.01)
        page.evaluate("document.querySelector('#elsewhere a').click()")
        other = page.wait(f"{chosen} !== {row} && {chosen}")
        assert table["gait"].iloc[other] != start["gait"]
        # keys: arrows go from cell to cell and around, space stops and plays, e goes elsewhere
        page.open(basins / "explore.html", f"#row={row}")
        page.evaluate("document.getElementById('map').focus()")
        page.press("ArrowRight")
        page.wait(f"{chosen} === {row + 1}")
        page.press("ArrowRight")
        page.wait(f"{chosen} === {row - 4}")  # psi_1 goes round
        page.press("ArrowUp")
        page.wait(f"{chosen} === {row - 4 + SIDE}")
        playing = "document.getElementById('play').getAttribute('aria-label')"
        before = page.evaluate(playing)
        page.press(" ")
        assert page.wait(f"{playing} !== '{before}' && {playing}") in ("play", "pause")
        page.press("e")
        page.wait(f"{chosen} !== {row - 4 + SIDE}")
        assert page.evaluate("document.getElementById('live').textContent").startswith("row ")
        # another value of psi_3 keeps the cell
        here = page.evaluate(chosen)
        page.evaluate("document.querySelectorAll('#slices button')[1].click()")
        page.wait(f"{chosen} === {here + SIDE**2}")
        # the body moves
        page.evaluate("document.getElementById('play').getAttribute('aria-label') === 'play' && play(true)")
        clock = page.evaluate("document.getElementById('clock').textContent")
        page.wait(f"document.getElementById('clock').textContent !== '{clock}'")
        painted = (
            "document.getElementById('body').getContext('2d').getImageData(0, 0, 600, 200).data.some(x => x)"
        )
        assert page.evaluate(painted)
        # the nearest start with another outcome beside it, in step; again the button hides it
        compare = "document.getElementById('compare')"
        beside = "document.getElementById('beside-body').clientWidth"
        assert page.evaluate(beside) == 0
        page.evaluate(f"{compare}.click()")
        assert page.evaluate(beside) == pytest.approx(
            page.evaluate("document.getElementById('body').clientWidth")
        )
        names = [
            page.evaluate(f"document.getElementById('{each}-name').textContent")
            for each in ("body", "beside")
        ]
        record = page.evaluate("other")
        assert names[1] == f"{table['gait'].iloc[record]}, row {record}" != names[0]
        assert page.evaluate("beside === walkOf.get(other).motions.find(each => each.name === motion.name)")
        assert page.evaluate(painted.replace("'body'", "'beside-body'"))
        page.evaluate(f"{compare}.click()")
        assert page.evaluate(beside) == 0
        _check_chain(page)
        # the link and the job of the row go to the clipboard
        page.evaluate("navigator.clipboard.writeText = async text => { window.taken = text; }")
        now = page.evaluate(chosen)
        for button, text in (
            ("copy-link", (basins / "explore.html").resolve().as_uri() + f"#row={now}"),
            ("copy-python", python_of(fields_of(basins / "explore.html"), now)),
        ):
            page.evaluate(f"document.getElementById('{button}').click()")
            assert page.evaluate("window.taken") == text
        # the map stays in sight while the record is read
        page.evaluate("scrollTo(0, 500)")
        assert page.evaluate("document.querySelector('.map').getBoundingClientRect().top") == 0
        page.evaluate("scrollTo(0, 0)")
        # nothing is asked of any other place, and a script that tries is refused
        assert all(request.startswith(("file:", "data:", "blob:")) for request in page.requests)
        assert sum(request.startswith("file:") for request in page.requests) == 1
        assert page.errors == []
        assert page.evaluate("fetch('https://example.org/').then(() => 'sent', () => 'refused')") == "refused"
        # a phone
        page.size(390, 844, 2.0)
        page.open(basins / "explore.html", "#row=8")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.evaluate("document.getElementById('map').getBoundingClientRect().width") > 300
        page.screenshot(tmp_path / "phone.png")
        assert page.errors == []


def test_points_of_a_branch_are_found_again_where_the_parameter_is_zero() -> None:
    """There the parameter is rounding, of which no digit is the same in another run."""
    at = StoredPoint(Points(np.zeros((1, 1)), ()))
    table = pd.DataFrame({"row": 0, "point": [0, 1, 2], "mu": [-0.5, 1e-17, 0.5]})
    followed = pd.DataFrame({"row": 0, "point": [0, 1, 2], "mu": [-0.5, -3e-17, 0.5 + 1e-6], "at": at})
    found = _points_of_records(table, np.array([0]), followed, ["point"], "mu")
    assert sorted(found) == [0, 1]
    table.loc[3] = (1, 0, np.nan)  # a row without a branch
    assert sorted(_points_of_records(table, np.array([0]), followed, ["point"], "mu")) == [0, 1]
