"""The command `animate`: movies and strips of poses from tables of traces."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

import gaitsweep as gs
from gaitsweep.cli import main
from gaitsweep.dynamics.ground import heights_of_model
from gaitsweep.job import Job
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.fukuoka2015.planar_quadruped.model import PlanarQuadruped
from gaitsweep.plot.limbs import limb_colours
from gaitsweep.skeleton import Limb, Skeleton, contact_signals
from gaitsweep.table import Snapshot
from gaitsweep.view import row_motion
from gaitsweep.view import row_movie as movie
from gaitsweep.view.explorer.replays import SAMPLES_PER_CYCLE, Crossings, ReplayedRow, Windows
from gaitsweep.view.movie import animation, movie_file, mujoco_movie, mujoco_painter, side_view
from gaitsweep.view.movie.side_view import SWING
from gaitsweep.view.row_motion import RowMotion, read_motion
from tests.support.trace_directories import (
    CYCLE,
    SPEED,
    quadruped_job,
    quadruped_signals,
    quadruped_skeleton,
    quadruped_table,
    written,
)

LINES = "--renderer", "matplotlib"
SMALL = "--size", "320x180"
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def quadruped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return quadruped_table(tmp_path_factory.mktemp("quadruped"))


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One row of a chain of four legs whose swings pass from leg to leg."""
    t = 0.1 * np.arange(400)
    signals = {}
    for i in range(1, 5):
        lift = np.maximum(np.sin(0.4 * t - i), 0.0)
        signals |= {f"phase_{i}": np.mod(0.4 * t - i, 2 * np.pi), f"x_{i}": 1.0 - 0.1 * lift}
        signals |= {f"l_{i}": 1.0 - 0.4 * lift, f"contact_{i}": (lift == 0.0).astype(float)}
    run = {"kind": "trace", "duration": 39.9, "every": 0.1}
    job = Job(name="wave", model="multilegged", start={f"psi_{i}": 1.0 for i in (1, 2, 3)}, run=run)
    frame = pd.DataFrame({"row": 0, "t": t, **signals, "status": "complete"})
    return written(tmp_path_factory.mktemp("chain"), job, [frame])


def refused(capsys: Capture, arguments: list[str], code: int = 2) -> str:
    assert main(["animate", *arguments]) == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert printed.err.endswith(".\n")
    return printed.err


def test_a_movie_has_a_picture_for_each_moment(quadruped: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "trot.gif"
    options = ["--start", "0.1", "--seconds", "0.2", "--speed", "0.5", "--fps", "10", *SMALL, *LINES]
    assert main(["animate", str(quadruped), "--out", str(out), *options]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"{out}\n"
    assert printed.err == f"Link: {out.as_uri()}\n"  # no bar where nobody looks
    with Image.open(out) as gif:
        assert gif.n_frames == 5  # type: ignore[attr-defined] (0.2 s at half speed are 0.4 s, both ends shown)
        assert gif.size == (320, 180)
        assert gif.info["duration"] == 100
        gif.seek(4)
        picture = np.array(gif.convert("RGB")).reshape(-1, 3)
    shown = {tuple(pixel) for pixel in picture.tolist()}
    for colour in ("white", *limb_colours(quadruped_skeleton().limbs)):
        assert tuple(round(255 * part) for part in to_rgb(colour)) in shown
    assert [path.name for path in tmp_path.iterdir()] == ["trot.gif"]


def test_movies_are_written_to_the_figures_and_follow_the_cycle(chain: Path, capsys: Capture) -> None:
    assert main(["animate", str(chain), "--seconds", "2", "--fps", "5", *SMALL]) == 0  # auto, without an MJCF
    printed = capsys.readouterr()
    assert printed.out == f"{chain / 'figures' / 'animation_row0.gif'}\n"
    assert printed.err == f"Link: {(chain / 'figures' / 'animation_row0.gif').as_uri()}\n"
    with Image.open(chain / "figures" / "animation_row0.gif") as gif:
        assert gif.n_frames == 2  # type: ignore[attr-defined] (ten times faster than life)
    assert movie.usual_speed(CYCLE) == 0.25
    assert movie.usual_speed(1.6) == 1.0
    assert [movie.usual_speed(period) for period in (np.nan, 0.0, np.inf)] == [1.0, 1.0, 1.0]


@pytest.mark.slow
def test_a_strip_of_poses_is_a_figure_of_its_directory(quadruped: Path, chain: Path, capsys: Capture) -> None:
    for directory in (quadruped, chain):
        assert main(["animate", str(directory), "--still", "0.1", "--size", "801x301", *LINES]) == 0
        file = directory / "figures" / "poses_row0.png"
        assert capsys.readouterr().out == f"{file}\n"
        assert Image.open(file).size == (801, 301)
        assert file in Snapshot.of(directory).figures
    assert "ends at" not in capsys.readouterr().err
    options = ["--still", "0.7", *SMALL, *LINES, "--out", str(quadruped / "late.png")]
    assert main(["animate", str(quadruped), *options]) == 0
    assert "ends at 0.8 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--row", "2"], "Row 2 does not exist: "),
        (["--row", "-1"], "has rows 0 to 1"),
        (["--row", "1"], "fell"),
        (["--size", "960"], "such as 960x540"),
        (["--size", "96x54"], "160 to 4096 pixels"),
        (["--renderer", "mujaco"], "did you mean mujoco?"),
        (["--start", "0.8"], "goes from 0 to 0.8 s"),
        (["--still", "nan"], "goes from 0 to 0.8 s"),
        (["--speed", "0"], "--speed is 0"),
        (["--seconds", "-1"], "--seconds is -1"),
        (["--fps", "nan"], "--fps is nan"),
        (["--lift", "0"], "--lift is 0"),
        (["--lift", "2", "--renderer", "mujoco"], "1 with --renderer mujoco"),
        (["--speed", "1e-6"], "2 to 3000"),
        (["--speed", "1e-320"], "2 to 3000"),
        (["--speed", "100"], "1 frame,"),
        (["--fps", "60"], "0.01 to 50"),
        (["--fps", "0.001"], "0.01 to 50"),
        (["--out", "walk.avi"], ".gif or .mp4"),
        (["--out", "walk.mp4"], "pip install 'gaitsweep[video]'"),
        (["--still", "0", "--out", "walk.gif"], "must end with .png"),
        (["--still", "0", "--speed", "1"], "--speed"),
    ],
)
def test_refusals_are_one_sentence(
    options: list[str], sentence: str, quadruped: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # as where it is not installed
    assert sentence in refused(capsys, [str(quadruped), *LINES, *options])


def test_tables_without_motion_are_refused(quadruped: Path, tmp_path: Path, capsys: Capture) -> None:
    assert "does not exist" in refused(capsys, [str(tmp_path / "nowhere")])
    settle = written(
        tmp_path / "settle",
        quadruped_job(run={"kind": "settle"}),
        [pd.DataFrame({"row": [0], "t_end": [np.nan], "status": ["fell"]})],
    )
    assert "ended with status fell" in refused(capsys, [str(settle)])
    branches = written(
        tmp_path / "branches",
        quadruped_job(
            vary={},
            numerics={"method": "rk4", "dt": 1.5e-4},
            run={"kind": "continuation", "parameter": "f", "path": [2.0, 3.2]},
        ),
        [pd.DataFrame({"row": [0], "status": ["complete"]})],
    )
    message = refused(capsys, [str(branches)])
    assert "continuation rows" in message
    assert "gaitsweep explore" in message
    t = 0.01 * np.arange(5)
    frame = pd.DataFrame({"row": 0, "t": t, **quadruped_signals(t), "status": "complete"})
    poor = written(tmp_path / "poor", quadruped_job(vary={}), [frame.drop(columns=["q_5"])])
    assert "lacks the signals q_5:" in refused(capsys, [str(poor)])
    heights = {f"height_{i}": 0.1 + t for i in (1, 2)}
    run = {"kind": "trace", "duration": 0.04, "every": 0.01}
    toy = Job(name="hops", model="toy_model:Toy", run=run)
    signals = {q.name: heights.get(q.name, 0.0 * t) for q in toy.design.model.signals}
    undrawn = written(
        tmp_path / "toy", toy, [pd.DataFrame({"row": 0, "t": t, **signals, "status": "complete"})]
    )
    message = refused(capsys, [str(undrawn)])
    assert "has no `skeleton`" in message
    asked = r"section `([^`]+)` of the page that `gaitsweep examples (\w+)` copies"
    section, page = re.findall(asked, " ".join(message.split()))[0]
    text = (Path(__file__).parents[2] / "docs" / f"{page}.md").read_text()
    (headed,) = re.findall(rf"^## [\d. ]*{section}\n(.*?)^## ", text, re.MULTILINE | re.DOTALL)
    assert "def skeleton(" in headed


def settled_toy(path: Path, t_end: float = 4856.8) -> Path:
    """A settled row, without simulating, of a model without a skeleton."""
    return written(
        path,
        Job(name="hops", model="toy_model:Toy", run={"kind": "settle"}),
        [pd.DataFrame({"row": [0], "t_end": [t_end], "status": ["settled"]})],
    )


def test_what_cannot_be_drawn_is_refused_before_its_row_is_simulated(
    tmp_path: Path, quadruped: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setattr(row_motion, "prepare", lambda _: pytest.fail("simulated"))
    monkeypatch.setattr(row_motion, "stored_job", lambda *_: pytest.fail("read"))
    assert "gaitsweep[video]" in refused(capsys, [str(quadruped), "--out", "walk.mp4"])
    assert "must end with .png" in refused(capsys, [str(quadruped), "--still", "0", "--out", "walk.gif"])
    monkeypatch.undo()
    monkeypatch.setattr(row_motion, "prepare", lambda _: pytest.fail("simulated"))
    assert "has no `skeleton`" in refused(capsys, [str(settled_toy(tmp_path / "toy"))])


def test_seconds_are_the_last_ones_of_a_row_that_is_simulated_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its samples end up to one sample early, and no sentence says that the row ends there."""
    folder = settled_toy(tmp_path / "toy")
    table = gs.load(folder)
    job = Job(**table.attrs["job"])
    every, told = 0.2 / SAMPLES_PER_CYCLE, []

    def replayed(windows: Windows) -> Iterator[ReplayedRow]:
        t = windows.first + every * np.arange(int(windows.length / every) + 2)
        crossings = Crossings(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 1)))
        yield ReplayedRow(0, 0, crossings, t, {"x": t}, -1)

    monkeypatch.setattr(row_motion, "prepare", lambda job: types.SimpleNamespace(model=job.design.model))
    replayer = types.SimpleNamespace(periods=np.array([0.2]), replayed=replayed)
    monkeypatch.setattr(row_motion, "replayer_of", lambda *_: replayer)
    for seconds in (0.33, 1.0, 3.0):
        t, signals, *_ = row_motion._simulated(job, table, 0, None, seconds)
        assert t[0] == pytest.approx(4856.8 - seconds)
        assert t[-1] == pytest.approx(4856.8, abs=every)
        motion = row_motion.RowMotion(job.design.model, {}, t, signals, 0.2, "", ())
        assert movie._end(motion, t[0], seconds, told.append) == pytest.approx(4856.8, abs=every)
    assert told == []
    movie._end(motion, t[0], 4.0, told.append)
    assert told == ["The motion of the row, and with it the figure, ends at 4856.8 s."]


def test_contacts_numbered_from_0_are_those_of_limbs_in_order() -> None:
    signals = {"contact_0": np.array([1.0, 0.0]), "contact_1": np.array([0.0, 1.0])}
    motion = RowMotion(PlanarQuadruped(), {}, np.array([0.0, 1.0]), signals, 0.2, "", ())
    np.testing.assert_array_equal(motion.contact(2), [[1.0, 0.0], [0.0, 1.0]])
    with pytest.raises(movie.PlotError, match="4 limbs, but 2 of the signals"):
        motion.contact(4)


def test_only_numbered_contacts_are_those_of_feet() -> None:
    t = np.array([0.0, 1.0, 2.0])
    signals = {"contact_2": np.array([0.0, 1.0, 1.0]), "contact_force": np.array([0.0, 1.0, 2.0])}
    motion = RowMotion(PlanarQuadruped(), {}, t, signals, 0.2, "", ())
    between = motion.at(np.array([0.75]))
    assert between["contact_force"] == pytest.approx(0.75)
    assert between["contact_2"] == 1.0
    assert contact_signals(["t", "contact_10", "contact_2", "contact_force", "contact_", "contact_0"]) == [
        "contact_0",
        "contact_2",
        "contact_10",
    ]


@pytest.mark.parametrize(
    ("run", "end"),
    [
        ({"kind": "settle", "max_cycles": 60}, "t_end"),
        ({"kind": "ramp", "parameter": "m_B", "path": [0.9, 1.0], "rate": 1e-3}, "t"),
    ],
)
@pytest.mark.slow
def test_a_row_without_a_trace_is_simulated_again(tmp_path: Path, run: dict[str, Any], end: str) -> None:
    """The last cycles of the row: the same motion as a trace of the same start, titled by its gait."""
    start: dict[str, Any] = {"psi_1": 1.13, "psi_2": 0.98, "psi_3": 1.5}
    job = Job(
        name="rows",
        model="multilegged",
        start={"psi_1": 1.13},
        vary={"psi_2": [0.98], "psi_3": [1.5]},
        run=run,
    )
    table = gs.run(job, tmp_path / "rows").table
    motion = read_motion(tmp_path / "rows", 0)
    last = float(np.max(table[end].to_numpy(float)))
    assert motion.t[-1] == pytest.approx(last, abs=motion.period / 64)
    assert motion.t[-1] - motion.t[0] == pytest.approx(4 * motion.cycle, rel=0.02)
    assert motion.gait == "direct"
    if run["kind"] == "settle":
        alone = gs.simulate("multilegged", **start, duration=last, every=motion.period / 640)
        for name in ("x_1", "l_3"):
            wanted = np.interp(motion.t, alone["t"], alone[name])
            np.testing.assert_allclose(motion.signals[name], wanted, atol=2e-3)  # between samples
    early = read_motion(tmp_path / "rows", 0, start=1.0, seconds=2.0)
    assert (early.t[0], early.t[-1]) == pytest.approx((1.0, 3.0), abs=motion.period / 64)
    with pytest.raises(movie.PlotError, match="goes from 0 to"):
        read_motion(tmp_path / "rows", 0, start=last + 1.0)
    out = movie.write_movie(tmp_path / "rows", fps=2.0, size=(320, 180))
    assert out.name == "animation_row0.gif"


@pytest.mark.slow
@pytest.mark.parametrize("moves", [False, True])
def test_a_trace_has_the_gait_of_its_end(tmp_path: Path, moves: bool) -> None:
    """The title of its movie has it, but for a trace whose parameter moves, which may have several."""
    run = {"kind": "trace", "duration": 200, "every": 1.0}
    moving = {"parameter": "m_B", "path": [0.9, 1.0], "rate": 1e-4} if moves else {}
    start: dict[str, Any] = {"psi_1": 1.13, "psi_2": 0.98, "psi_3": 1.5}
    result = gs.run(
        Job(name="trace", model="multilegged", start=start, run=run | moving, verify=0), tmp_path / "trace"
    )
    assert set(result.table["gait"]) == {"direct"}
    assert read_motion(tmp_path / "trace", 0).gait == ("" if moves else "direct")
    table = gs.simulate("multilegged", **start, duration=20.0, every=5.0)
    assert not {"gait", "outcome", "status"} & set(table.columns)


def title_of(motion: RowMotion, times: np.ndarray) -> str:
    with movie._prepared(motion, times, "", "matplotlib", 1.0, None) as (clip, _):
        return clip.title


def test_a_movie_is_titled_by_gait_and_speed(quadruped: Path, chain: Path) -> None:
    for folder, gait, title in (
        (quadruped, "trot", f"waist_quadruped, trot at {SPEED:.3g} m/s"),
        (quadruped, "", f"waist_quadruped, at {SPEED:.3g} m/s"),
        (chain, "direct", "multilegged, direct"),  # which has no speed
    ):
        motion = dataclasses.replace(read_motion(folder, 0), gait=gait)
        assert title_of(motion, motion.t) == title


def test_the_speed_of_a_title_is_that_of_whole_strides(quadruped: Path) -> None:
    """The body surges by 6 mm twice a cycle, which is up to 40 % of the speed of a part of a cycle."""
    motion = read_motion(quadruped, 0)
    surge = 0.006 * np.sin(4.0 * np.pi * motion.t / CYCLE + 0.3)
    motion = dataclasses.replace(motion, signals={**motion.signals, "q_0": motion.signals["q_0"] + surge})
    for first, last in ((0.0, 0.8), (0.05, 0.5), (0.0, 0.05), (0.3, 0.35), (0.7, 0.8)):
        ((speed,),) = [re.findall(r"at (\S+) m/s", title_of(motion, np.linspace(first, last, 6)))]
        # touchdowns lie between samples, and so do the positions
        assert float(speed) == pytest.approx(SPEED, rel=0.004), (first, last)
    scuffed = {}
    for name, contact in motion.signals.items():
        scuffed[name] = contact.copy()
        if name.startswith("contact_"):  # a foot that touches the ground for a sample in each swing
            middle = np.flatnonzero(np.diff(contact) < 0)[:2] + 10
            scuffed[name][middle[middle < len(contact)]] = 1.0
    title = title_of(dataclasses.replace(motion, signals=scuffed), np.linspace(0.05, 0.6, 6))
    assert float(re.findall(r"at (\S+) m/s", title)[0]) == pytest.approx(SPEED, rel=0.004)


def test_cycles_of_a_clip_are_measured_strides(quadruped: Path) -> None:
    """A nominal period that is wrong by 15 % changes neither the cycle nor the part of whole cycles."""
    motion = read_motion(quadruped, 0)
    motion = dataclasses.replace(motion, period=0.85 * motion.period)
    assert motion.cycle == pytest.approx(CYCLE, rel=0.01)  # between samples
    part = motion.of_whole_cycles()
    cycles = (part.t[-1] - part.t[0]) / motion.cycle
    assert cycles == pytest.approx(round(cycles), abs=1e-9)
    assert part.t[-1] == motion.t[-1]
    assert part.t[0] - motion.t[0] < motion.cycle
    airborne = {
        name: 0.0 * values if "contact" in name else values for name, values in motion.signals.items()
    }
    assert dataclasses.replace(motion, signals=airborne).cycle == motion.period


def test_the_speed_of_a_title_is_that_of_the_table(quadruped: Path) -> None:
    """Where the clip contains the end of the recorded cycle; a clip before it has its own speed."""
    motion = dataclasses.replace(read_motion(quadruped, 0), recorded=(0.1234, 0.8))
    assert title_of(motion, np.linspace(0.3, 0.7, 6)).endswith("at 0.123 m/s")
    assert title_of(motion, np.linspace(0.0, 0.3, 6)).endswith(f"at {SPEED:.3g} m/s")
    model = motion.model
    record = pd.Series({"speed_end": 0.2, "status": "settled"})
    assert row_motion._recorded_speed(model, record) == 0.2
    assert row_motion._recorded_speed(model, pd.Series({"speed_n": 0.3})) == 0.3
    of_orbit = pd.Series({"speed_end": 0.2, "attractor_period": 2})  # the speed of one of its two cycles
    assert row_motion._recorded_speed(model, of_orbit) is None
    assert row_motion._recorded_speed(model, pd.Series({"speed_end": np.nan})) is None
    of_a_toy = gs.models.find("multilegged")()
    assert row_motion._recorded_speed(of_a_toy, record) is None


def test_the_speed_of_a_body_that_moves_backwards_is_negative(quadruped: Path) -> None:
    motion = read_motion(quadruped, 0)
    backwards = dataclasses.replace(
        motion, gait="", signals={name: values[::-1] for name, values in motion.signals.items()}
    )
    assert title_of(backwards, motion.t) == f"waist_quadruped, at {-SPEED:.3g} m/s"


@pytest.mark.parametrize(("axes", "lines", "cut"), [(2, 1, False), (5, 2, False), (12, 2, True)])
def test_all_swept_values_are_named_or_missing_ones_marked(
    chain: Path, axes: int, lines: int, cut: bool
) -> None:
    motion = read_motion(chain, 0)
    values = [f"parameter {i} = 1.5 kg" for i in range(axes)]
    motion = dataclasses.replace(motion, gait="direct", details=("row 3", *values))
    with movie._prepared(motion, motion.t, "", "matplotlib", 1.0, None) as (clip, draw):
        figure = animation.still(dataclasses.replace(clip, t=clip.t[:2]), (1600, 560), draw)
    written = figure.texts[:lines]
    named = written[-1].get_text()
    assert named.startswith("multilegged, direct; row 3: " if lines == 1 else "row 3: ")
    assert [value for value in values if value not in named] == (values[named.count(" = ") :] if cut else [])
    assert named.endswith(", ...") == cut
    assert named.count(" = ") > 4 or not cut
    renderer = [text.get_window_extent() for text in written]
    assert all(box.x1 <= figure.bbox.width for box in renderer)
    assert lines == 1 or renderer[1].y1 < renderer[0].y0


def test_a_body_of_an_mjcf_is_drawn_from_its_geoms(tmp_path: Path) -> None:
    """The hopper's trunk and foot, which bounce; the result's model is found from any folder."""
    t = 0.01 * np.arange(50)
    job = Job(name="hops", model=gs.load_job("builtin:mujoco_hopper").model,
              run={"kind": "trace", "duration": 0.49, "every": 0.01})  # fmt: skip
    signals = {q.name: np.zeros_like(t) for q in job.design.model.signals} | {"q_0": 0.05 * np.sin(20.0 * t)}
    folder = written(
        tmp_path / "hops", job, [pd.DataFrame({"row": 0, "t": t, **signals, "status": "complete"})]
    )
    assert "mujoco_hopper" not in sys.modules  # as in a process that has only the result
    motion = read_motion(folder, 0)
    skeleton = motion.model.skeleton(motion.values, motion.signals)
    assert skeleton is not None
    trunk, foot = skeleton.bodies
    for body, rest in ((trunk, 0.4), (foot, 0.1)):
        np.testing.assert_allclose(body[..., 2].mean(axis=1), rest + signals["q_0"], atol=1e-9)
    out = movie.write_movie(folder, renderer="matplotlib", fps=5.0, size=(320, 180))
    with Image.open(out) as gif:
        gif.seek(gif.n_frames - 1)  # type: ignore[attr-defined]
        assert (np.array(gif.convert("RGB"))[20:120] < 250).any()


def test_legs_in_swing_are_coloured_and_lifted_on_request(chain: Path) -> None:
    """The chain's legs have one colour, so another marks those in swing; only these are lifted."""
    motion = read_motion(chain, 0)
    skeletons = []
    for lift in (1.0, 3.0):
        with movie._prepared(motion, motion.t, "", "auto", lift, None) as (clip, draw):
            skeletons.append(clip.skeleton)
            figure = Figure()
            draw(figure.add_axes((0, 0, 1, 1)), clip, named=True).show(20)
    colours = [line.get_color() for line in figure.axes[0].lines if np.size(line.get_xdata()) == 2][: 3 * 4]
    swing = [bool(motion.signals[f"contact_{i}"][20] == 0.0) for i in range(1, 5)]
    assert [SWING in colours[i : i + 1] for i in range(0, 8, 2)] == swing
    assert 0 < sum(swing) < 4
    for plain, high in zip(skeletons[0].limbs, skeletons[1].limbs, strict=True):
        np.testing.assert_allclose(high.points[:, 0], plain.points[:, 0])
        np.testing.assert_allclose(high.points[:, 1, 2], 3.0 * plain.points[:, 1, 2], atol=1e-12)
        assert plain.points[:, 1, 2].max() > 0.1
    assert "3 times as high" in clip.title


def test_a_strip_without_a_time_is_of_the_last_cycle(
    quadruped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = []

    def still(clip: animation.Clip, *_: object) -> Figure:
        times.append(clip.t)
        return Figure()

    monkeypatch.setattr(animation, "still", still)
    out = str(tmp_path / "poses.png")
    directory = str(quadruped)
    for arguments in ([directory, "--still"], ["--still", directory], [directory, "--still", "0.4"]):
        assert main(["animate", *LINES, "--out", out, *arguments]) == 0
    period = read_motion(quadruped, 0).cycle
    last, at = 0.8 - period + period / 6.0 * np.arange(6), np.linspace(0.4, 0.8, 6, endpoint=False)
    for found, wanted in zip(times, [last, last, at], strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_unwritable_files_are_refused(chain: Path, tmp_path: Path, capsys: Capture) -> None:
    out = str(tmp_path / "nowhere" / "wave.gif")
    assert "no such file" in refused(capsys, [str(chain), "--out", out, "--seconds", "4"], code=1)
    assert "no MJCF" in refused(capsys, [str(chain), "--renderer", "mujoco"])


def test_a_movie_that_is_stopped_leaves_the_old_one(chain: Path, tmp_path: Path) -> None:
    out = tmp_path / "wave.gif"
    out.write_bytes(b"the old one")

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        movie.write_movie(chain, out, seconds=20.0, size=(320, 180), on_progress=stop)
    assert out.read_bytes() == b"the old one"
    assert [path.name for path in tmp_path.iterdir()] == ["wave.gif"]


@pytest.mark.slow
def test_an_mp4_is_written_by_ffmpeg(chain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that writes the number of its input bytes to its last argument replaces it."""
    program = tmp_path / "ffmpeg"
    program.write_text('#!/bin/sh\nfor target; do :; done\nwc -c > "$target"\n')
    program.chmod(0o755)
    fake = types.ModuleType("imageio_ffmpeg")
    fake.get_ffmpeg_exe = lambda: str(program)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", fake)
    out = movie.write_movie(chain, tmp_path / "wave.mp4", seconds=8.0, fps=5.0, size=(320, 180))
    assert int(out.read_text()) == 5 * 320 * 180 * 3
    program.write_text("#!/bin/sh\ncat > /dev/null\necho 'no such codec.' >&2\nexit 3\n")
    with pytest.raises(movie.PlotError, match=r"could not write the movie: no such codec\.$"):
        movie.write_movie(chain, out, seconds=8.0, fps=5.0, size=(320, 180))
    assert int(out.read_text()) == 5 * 320 * 180 * 3


def test_a_skeleton_that_is_not_finite_is_refused(chain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of_chain = Multilegged.skeleton

    def lost(self: Any, *arguments: Any) -> Skeleton:
        return side_view.with_points(of_chain(self, *arguments), lambda points: points * np.nan)

    monkeypatch.setattr(Multilegged, "skeleton", lost)
    with pytest.raises(movie.PlotError, match=r"skeleton that cannot be drawn: .* not finite"):
        movie.write_movie(chain)


def test_an_upright_spring_is_drawn_and_a_point_on_the_ground_refused(
    chain: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    spring = np.zeros((1, 2, 3))

    def skeleton(self: Multilegged, values: Any, signals: Any) -> Skeleton:
        return Skeleton((), springs=(np.repeat(spring, len(signals["l_1"]), axis=0),))

    monkeypatch.setattr(Multilegged, "skeleton", skeleton)
    with pytest.raises(gs.plot.PlotError, match="point on the ground"):
        movie.write_still(chain, tmp_path / "point.png")
    spring[0, 0, 2] = 1.0
    assert movie.write_still(chain, tmp_path / "spring.png").exists()


@pytest.mark.parametrize("fps", [25.0, 30.0, 40.0, 48.0])
def test_a_gif_lasts_as_long_as_its_frames(fps: float, tmp_path: Path) -> None:
    """A GIF has whole hundredths of a second for each frame, which have to add up to the right length."""
    pictures = np.full((24, 16, 64, 3), 255, np.uint8)
    for number, picture in enumerate(pictures):
        picture[:, number : number + 8] = 0
    movie_file.save(tmp_path / "moving.gif", iter(pictures), len(pictures), fps)
    with Image.open(tmp_path / "moving.gif") as gif:
        assert gif.n_frames == 24  # type: ignore[attr-defined]
        durations = []
        for number in range(24):
            gif.seek(number)
            durations.append(gif.info["duration"])
    assert abs(sum(durations) - 24e3 / fps) <= 5.0
    assert max(durations) - min(durations) <= 10


@pytest.mark.slow
def test_mujoco_renders_with_opengl(quadruped: Path, tmp_path: Path) -> None:
    out = tmp_path / "trot.gif"
    options = {"seconds": 0.05, "fps": 10.0, "size": (320, 240)}
    try:
        movie.write_movie(quadruped, out, renderer="mujoco", **options)
    except movie.PlotError as error:
        pytest.skip(str(error))
    with Image.open(out) as gif:
        assert gif.n_frames == 3  # type: ignore[attr-defined] (a quarter of the speed)
        scene = np.array(gif.convert("RGB"))[30:90]
    assert len(np.unique(scene.reshape(-1, 3), axis=0)) > 30  # shaded, as lines are not


def test_mujoco_draws_an_mjcf_without_a_sky_on_white() -> None:
    model = mujoco_painter._staged('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>', 0.1)
    assert list(model.tex_type) == [mujoco.mjtTexture.mjTEXTURE_SKYBOX]
    assert set(model.tex_data) == {255}


def test_mujoco_draws_geoms_of_groups_0_to_2_and_no_sites() -> None:
    """The scene is that of the renderer, before OpenGL."""
    geoms = "".join(f'<geom name="{i}" group="{i}" size=".1"/>' for i in range(6))
    sites = "".join(f'<site name="foot_{i}" group="{i}" size=".2"/>' for i in range(6))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}{sites}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, maxgeom=20)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, mujoco_painter._shown(), None, mujoco.MjvCamera(), everything, scene)
    drawn = [(geom.objtype, geom.objid) for geom in scene.geoms[: scene.ngeom]]
    assert drawn == [(mujoco.mjtObj.mjOBJ_GEOM, i) for i in range(3)]


def test_ground_of_one_colour_gets_squares() -> None:
    """Two squares a repeat; a ground with a material of its own keeps it, whatever its name."""
    floors = '<geom type="plane" size="0 0 1"/><geom type="plane" size="1 1 1" material="squares"/>'
    texture = '<texture name="squares" type="2d" builtin="flat" width="8" height="8"/>'
    asset = f'<asset>{texture}<material name="squares" texture="squares"/></asset>'
    world = f'<worldbody>{floors}<geom size="1"/></worldbody>'
    model = mujoco_painter._staged(f"<mujoco>{asset}{world}</mujoco>", 0.1)
    names = [model.mat(i).name if i >= 0 else "" for i in model.geom_matid]
    assert names == ["gaitsweep/squares", "squares", ""]
    assert (model.mat(names[0]).texrepeat == 5.0).all()
    assert {209, 237} <= set(model.tex_data)


def test_without_opengl_lines_are_drawn(
    quadruped: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mujoco_movie, "BACKENDS", ("nonsense",))  # MuJoCo's import fails with it
    options = [str(quadruped), "--out", str(tmp_path / "trot.png"), *SMALL, "--still", "0"]
    assert main(["animate", *options]) == 0
    message = capsys.readouterr().err
    assert message.startswith("MuJoCo cannot render here (nonsense: ")
    assert "Matplotlib" in message
    assert (tmp_path / "trot.png").exists()
    assert "use --renderer matplotlib" in refused(capsys, [*options, "--renderer", "mujoco"])


def test_uneven_ground_is_drawn_below_the_feet() -> None:
    """The line has the heights of the model's ground, and the camera follows it."""
    model = PlanarQuadruped(ground="slope")
    values = {"ground_slope": 10.0}
    x = np.array([-1.0, 0.0, 2.0])
    heights = heights_of_model(model, values, x)
    assert heights is not None
    np.testing.assert_allclose(heights, [0.0, 0.0, 2.0 * np.tan(np.radians(10.0))], atol=1e-12)
    assert heights_of_model(PlanarQuadruped(), values, x) is None
    body = np.zeros((1, 2, 3)) + np.array([[2.0, 0.0, 0.5], [2.2, 0.0, 1.0]])
    leg = Limb("leg", np.stack([body[:, 1], body[:, 0]], axis=1))
    skeleton = Skeleton((leg,), (body,), ground=np.column_stack([x, heights]))
    axes = Figure().subplots()
    side_view.SideView(axes, skeleton, np.ones((1, 1), bool), np.array([[2.0, 0.0]]), named=False)
    drawn = [line.get_xydata() for line in axes.get_lines() if np.size(line.get_xdata()) == 3]
    below = np.interp(2.0 + 0.2 * np.linspace(-1.0, 1.0, 21), x, heights).mean()  # the last height beyond
    np.testing.assert_allclose(np.asarray(drawn), [np.column_stack([x - 2.0, heights - below])], atol=1e-12)


@pytest.mark.parametrize("slope", [-0.2, 0.2])
def test_a_body_stays_in_the_picture_on_a_slope(slope: float) -> None:
    x = np.linspace(0.0, 40.0, 50)
    places = np.linspace(-4.0, 44.0, 200)
    limb = np.stack([x, 0.0 * x, slope * x], axis=1)[:, None] + np.outer([1.0, 0.5, 0.0], [0.0, 0.0, 1.0])
    skeleton = Skeleton((Limb("leg", limb),), ground=np.column_stack([places, slope * places]))
    axes = Figure(figsize=(9.6, 5.4)).subplots()
    view = side_view.SideView(axes, skeleton, np.ones((50, 1), bool), limb[:, 2, :2])
    low, high = axes.get_ylim()
    assert high - low < 2.0  # the leg is 1 m long
    for k in (0, 25, 49):
        view.show(k)
        drawn = np.asarray(view._limbs[0][0].get_ydata())
        assert low < drawn[-1] < drawn[0] < high


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("swings", [0.0, 0.8])
def test_a_body_that_hangs_is_in_the_picture(swings: float) -> None:
    """A rod of 1 m on a pivot at a height of 0, upright or swinging."""
    angle = swings * np.sin(np.linspace(0.0, 6.0, 20))
    rod = np.zeros((20, 2, 3))
    rod[:, 1, 0], rod[:, 1, 2] = np.sin(angle), -np.cos(angle)
    axes = Figure(figsize=(9.6, 5.4)).subplots()
    pivot = np.zeros((20, 2))
    side_view.SideView(axes, Skeleton((Limb("rod", rod),)), np.zeros((20, 1), bool), pivot)
    low, high = axes.get_ylim()
    assert low < -1.0 < 0.0 < high < 2.0
    assert side_view.bounds(Skeleton((Limb("rod", rod),)), pivot)[1] == 1.0


def test_feet_are_lifted_from_uneven_ground() -> None:
    """A foot that stands on ground 1 m high keeps its place; one 0.1 m above it is 0.3 m above it."""
    limb = np.zeros((2, 3, 3))
    limb[..., 2] = [[1.8, 1.4, 1.0], [1.8, 1.5, 1.1]]
    skeleton = Skeleton((Limb("leg", limb),), ground=np.array([[-1.0, 1.0], [1.0, 1.0]]))
    lifted = side_view.lifted(skeleton, 3.0).limbs[0].points[..., 2]
    np.testing.assert_allclose(lifted, [[1.8, 1.4, 1.0], [1.8, 1.6, 1.3]], atol=1e-12)
