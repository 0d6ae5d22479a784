"""Each notebook runs from its first cell to its last, in a kernel of its own, and its text's claims hold.

Its stored outputs, which the documentation shows, are those that it gives.
"""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
from IPython.core.interactiveshell import InteractiveShell
from nbclient import NotebookClient
from nbformat import NotebookNode

from gaitsweep.shipped import EXAMPLES
from tests.support import unoptimised_flags

FOLDER = Path(__file__).parents[2] / "notebooks"
MOST_BYTES = 300_000  # outputs included
SECONDS_OF_A_CELL = 300
# What a notebook's text says, over the names that its cells leave behind.
CLAIMS = {
    # Each limit is the text's, a trace's sampling (0.04 rad), or by how much the full model's legs and ground
    # give way (0.11 rad in the paper, 1e-4 of a period). The defective pair of 2/3 is met to 4e-4 in slow
    # walking, and to 0.15 at Table 1's omega.
    "multilegged_tour.ipynb": """
assert np.abs(on_section[-1] - on_section[-10]).max() < 0.02
assert np.abs(on_section[-1, [0, 2]] - [1.13, 5.29]).max() < 0.05  # a source wave
assert (basins["status"] == "settled").all()
assert basins["distance"].max() < 0.12
assert abs(direct["psi_2_end"].median() - float(theory.lag(chain))) < 0.02
assert list(found.summary["kind"]) == ["line"] * 3 and agreement > 0.95
assert (measured.panels["boundary_entropy"] < np.log(2)).all()
assert same > 0.97
assert error < 1e-12
assert fixed.converged.all()
assert np.abs(cycle["period, s"] / cycle["theory, s"] - 1).max() < 1e-4
assert np.abs(np.poly(leading[2, :3]) - np.poly(expected)).max() < 1e-3
assert np.abs(leading[:, 3]).max() < 1e-3
assert abs(np.median(np.diff(E)[:300]) - law) < 1e-9
assert (ends.loc[ends["m_1"] < ends["m_end"], "gait"] == "retrograde").all()
assert (ends.loc[ends["m_1"] > ends["m_end"], "gait"] == "direct").all()
assert np.abs(summary["most cycles"] / summary["along all of the line"] - 1)[[0.7, 0.95]].max() < 0.15
assert not inside["share of others"].any()
assert gaits.loc[gaits["m_B"] < 0.5, "share of others"].all()
""",
    # At its flip the multiplier is -1; beside it a disturbance grows or dies by the multiplier there.
    "road_map.ipynb": """
assert runner.gaits["stable"].tolist() == [False, True] and runner.missing == 0
assert runner.points["special"].tolist() == ["fold", "flip"]
assert flip["coefficient"] < 0
slopes = [gs.return_map(RUNNER, alpha=flip["alpha"] + d) for d in (-0.05, 0.05)]
factors = [abs(s.multipliers(s.fixed_points([flip["z_n"]])))[0, 0] for s in slopes]
assert factors[0] < 1 < factors[1]
assert abs(np.log(abs(apex[-1] - height)[0] / 1e-5) - 30 * np.log(factors[1])) < 0.3
assert set(plane.curves["part"]) == {"fold", "flip"}
""",
    # Samples are 2 ms apart. Steps of 0.2 ms move delta_13 by 0.005 rad at most. Edges hold those that
    # located events give on a grid ten times finer; the unstable gait lies among those that Newton finds.
    "waist_quadruped_tour.ipynb": """
for row, late in ((0, 0.052), (1, 0.018)):
    one = gaits.table[gaits.table["row"] == row]
    lands = {}
    for limb in (1, 4):
        foot, t = one[f"contact_{limb}"].to_numpy() > 0.5, one["t"].to_numpy()
        down, up = t[1:][foot[1:] & ~foot[:-1]], t[1:][~foot[1:] & foot[:-1]]
        lands[limb] = np.array([each for each in down if 0.05 < each - up[up < each].max(initial=-1) < 0.2])
    lag = lands[1][-1] - lands[4][lands[4] < lands[1][-1]][-1]
    assert abs(lag - late) < 0.003
walks, trots = ends[1][ends.index < 2.6], ends[1][ends.index > 2.6]
assert (walks - 2.37).abs().max() < 0.01 and (trots - 2.81).abs().max() < 0.01
assert (ends[0] - ends.index).abs().max() < 2e-3
up, down = (stairs[(stairs["pass"] == n) & (stairs["f"] > 2.5) & (stairs["f"] < 2.7)] for n in (0, 1))
assert (up["delta_13_n"] > 2.75).all() and (down["delta_13_n"] < 2.45).all()
lost = edges.set_index("gait")
assert lost.loc["trot", "kept"] < 2.84 < 2.86 < lost.loc["trot", "lost"]
assert lost.loc["walk", "lost"] < 2.34 < 2.35 < lost.loc["walk", "kept"]
assert points["stable"].tolist() == [True, True, False, True, True]
assert np.abs(points["value"] - [2.843, 2.37, 2.61, 2.81, 2.348]).max() < 0.03
gaits_at = grid.groupby(["beta", "f"])["gait"].agg(lambda gait: " ".join(sorted(set(gait.astype(str)))))
assert (gaits_at.unstack().iloc[0] == "trot").all() and (gaits_at.unstack().iloc[-1] == "walk").all()
both = gaits_at[gaits_at == "trot walk"].reset_index()
assert both["beta"].corr(both["f"]) < -0.8
""",
    # Speeds and shares are the text's; the families over speed and on the ramp are those of the docs' tables.
    "planar_quadruped_tour.ipynb": """
assert gs.analyses.gait_bouts(along, "gait")["gait"].tolist() == ["trot", "D-walk"]
assert abs(along["delta_1"].iloc[-1] + 0.2) < 0.03 and abs(along["delta_2"].iloc[-1] + 0.2) < 0.03
assert (found.loc[found["k2"] == 0, "gait"] == "trot").all()
assert table.loc["D-walk", "max"] < 0.8 < table.loc["trot", "min"] < table.loc["trot", "max"] < 1.6
assert table.loc[["uR-canter", "uL-canter"], "max"].max() < table.loc[["RT-gallop", "LT-gallop"], "min"].min()
told = judged.set_index("measure")
assert told.loc["load_together", "r"] < -0.9 and told.loc["load_together", "right"] == 1
assert -0.9 < told.loc["load_late", "r"] < -0.4
assert told.loc["tilt_late", "r_low"] < 0 < told.loc["tilt_late", "r_high"]
shown = gs.analyses.gaits_in(traced)
assert set(best["gait"].astype(str)) == set(shown["gait"].astype(str)) and len(best) == 9
families = passages.groupby("row")["family"].agg(list)
assert families[0] == families[1] == ["trot"]
way = ["walk", "trot", "canter", "trot", "canter", "gallop", "canter", "trot", "walk"]
assert families[2][1:] == families[3][1:] == way
assert passages.loc[(passages["row"] > 1) & (passages["family"] == "canter"), "speed_end"].min() < 1.5
assert passages.loc[(passages["row"] > 1) & (passages["family"] == "trot"), "speed_end"].max() > 1.75
""",
    # Runge-Kutta steps are exact on parabolas: what is left is the error of an event's time, 1e-12 s, times
    # omega or g. Flips are located to 1e-6 of the range. A sweep finds no gait where it is not stable.
    "your_own_model.ipynb": """
assert max(of_phase.max(), of_launch.max()) < 2e-10
assert fixed.converged.all()
assert np.abs(fixed.points.at - np.stack([lands, steady], axis=1)).max() < 1e-8
for i in range(3):
    slope = PUSH / 2 * np.sin(lands[i])
    trace_, determinant = 1 + E - slope * 2 * OMEGA / G, E
    assert np.abs(np.poly(found[i]) - [1, -trace_, determinant]).max() < 1e-7
shares = np.array(list(counts.values()))
assert (shares[:, 1] > 0.7 * shares[:, 0]).all() and not shares[:, 2].any()
assert basins.loc[basins["launch_0"] > 4, "gait"].eq("2:1").mean() > 0.8
assert same == 1 and abs(2 * OMEGA / G * limp[:3].sum() / (2 * np.pi) - 3) < 1e-9
assert np.ptp(limp[:3]) > 1 and np.abs(limp[3:6] - limp[:3]).max() < 1e-9
assert np.abs(flips / analytic - 1).max() < 1e-5
assert (stuck["status"] == "event_stall").all()
""",
    # The planted constants; the limits are the text's. Branches lie within 0.03 rad of what a figure shows.
    "which_constants.ipynb": """
assert abs(best.kappa / 100 - 1) < 0.02 and abs(best.beta / 0.8 - 1) < 0.001
assert found.identifiability.fitting > 20 and even.identifiability.fitting > 10
size = effects[effects["index"] == "mu_star"].pivot(index="parameter", columns="output", values="value")
assert size["direct"].notna().all() and size["retrograde"].notna().all()
assert (size.loc["beta", ["direct", "retrograde"]] > size.loc["kappa", ["direct", "retrograde"]]).all()
assert (size.loc["K", ["direct", "retrograde"]] < 0.05 * size.loc["kappa", ["direct", "retrograde"]]).all()
verdicts = {each.name: each for each in found.identifiability.constants}
assert verdicts["kappa"].verdict == "free" and verdicts["beta"].verdict == "pinned"
assert 0.785 < verdicts["beta"].low < verdicts["beta"].high < 0.815
assert 70 < verdicts["kappa"].low < 85 and 150 < verdicts["kappa"].high < 190
assert (ends.loc[2.6] - [2.74, 3.02]).abs().max() < 0.01
assert abs(ends.loc[3.2].iloc[0] - 2.70) < 0.01 and abs(ends.loc[2.0].iloc[1] - 3.04) < 0.01
""",
}


def notebook(name: str) -> NotebookNode:
    return nbformat.read(FOLDER / name, as_version=4)


def _imports(source: str) -> list[str]:
    return [line for line in source.splitlines() if line.lstrip().startswith(("import ", "from "))]


def test_every_notebook_is_tested() -> None:
    assert sorted(path.name for path in FOLDER.glob("*.ipynb")) == sorted(CLAIMS)


@pytest.mark.parametrize("name", sorted(CLAIMS))
def test_a_notebook_as_it_is_kept(name: str) -> None:
    """Small, valid, run from top to bottom without an error, and without a path of the machine it ran on.

    What they import of the package is `gaitsweep` itself, the Python API.
    """
    kept = notebook(name)
    nbformat.validate(kept)
    assert (FOLDER / name).stat().st_size < MOST_BYTES
    code = [cell for cell in kept.cells if cell.cell_type == "code"]
    assert not any("gaitsweep." in line for cell in code for line in _imports(cell.source))
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    for output in (output for cell in code for output in cell.outputs):
        assert output.output_type != "error"
        assert output.get("name") != "stderr" or output["text"].startswith("UserWarning: ")
        assert "/tmp/" not in str(output)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CLAIMS))
def test_a_notebook_runs_and_its_claims_hold(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("XLA_FLAGS", unoptimised_flags())
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    run = notebook(name)
    run.cells.append(nbformat.v4.new_code_cell(CLAIMS[name]))
    client = NotebookClient(
        run,
        timeout=SECONDS_OF_A_CELL,
        kernel_name="python3",
        resources={"metadata": {"path": str(elsewhere)}},
    )
    client.execute()
    assert not list(elsewhere.iterdir())  # a notebook leaves nothing where it is started
    for kept, made in zip(notebook(name).cells, run.cells, strict=False):
        assert_alike(written(kept), written(made))


# where a warning comes from, with the number of a process; notebooks are kept without it
_PLACE = re.compile(r"^\S+:\d+: (?=\w*Warning: )", re.MULTILINE)
_PROGRESS = re.compile(r"^\d+/\d+ (?:rows|sets), .*\n", re.MULTILINE)  # only where a cell takes half a minute
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


def written(cell: NotebookNode) -> str:
    """The text of a cell's outputs; figures by their size."""
    if cell.cell_type != "code":
        return ""
    texts = []
    for output in cell.outputs:
        data = output.get("data", {})
        message = _PLACE.sub("", _PROGRESS.sub("", output.get("text", "")))
        texts += [message, data.get("text/plain", ""), data.get("text/html", "")]
    return " ".join(texts)


def assert_alike(kept: str, made: str) -> None:
    """The words are the same, and the numbers but for what rounding decides on another processor.

    A row or two that settle elsewhere change a count by a percent, and what is rounding itself is anything
    below 1e-6.
    """
    words = ["".join(_NUMBER.sub("0", text).split()) for text in (kept, made)]
    assert words[0] == words[1]
    numbers = [[float(each) for each in _NUMBER.findall(text)] for text in (kept, made)]
    np.testing.assert_allclose(*numbers, rtol=0.03, atol=1e-6)


def test_the_own_model_of_the_notebook_is_the_shipped_example() -> None:
    cells = notebook("your_own_model.ipynb").cells
    cell = next(each for each in cells if each.source.startswith("%%writefile hopper.py"))
    assert cell.source.partition("\n")[2].strip() == (EXAMPLES / "hopper.py").read_text().strip()


def test_errors_of_users_have_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    """IPython shows the message without the stack of the package."""
    shell = InteractiveShell.instance()
    shell.run_cell("import gaitsweep as gs\ngs.load('nowhere')")
    shown = capsys.readouterr().out.strip().splitlines()
    assert len(shown) == 1
    assert shown[0].startswith("TableError: nowhere does not exist")
