"""The comments that name commands for the pages' numbers can be read, and their commands exist."""

from __future__ import annotations

import functools
import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from typer.core import TyperGroup

from benchmarks.docs_numbers import (
    ROOT,
    Check,
    Outputs,
    Stated,
    checks,
    compared,
    main,
    pages,
    sourced,
    unsourced,
)
from gaitsweep.cli.commands import app

PAGE = """# Gaits
The trot is at 3.09 rad, in 29 403 rows.

<!-- numbers: gaitsweep run sweeps/quick_basins.yaml && \\
     gaitsweep info results/quick_basins
trot * {3.09} rad
rows ... all {29 403}
-->
"""


@pytest.mark.parametrize(
    ("stated", "printed", "equal"),
    [
        (Stated("3.09"), "3.0949", True),
        (Stated("3.09"), "3.11", False),
        (Stated(".12"), "0.125", True),
        (Stated("29 403"), "29403", True),
        (Stated("300"), "301", False),
        (Stated("2e-9"), "2.4e-09", True),
        (Stated("2e-9"), "2.6e-09", False),
        (Stated("24", tolerance="3"), "26.9", True),
        (Stated("1e-2", bound=True), "6.5e-07", True),
        (Stated("1e-2", bound=True), "0.02", False),
        (Stated("15.0", percent=True), "0.1496", True),
    ],
)
def test_numbers_are_equal_to_the_digits_of_the_page(stated: Stated, printed: str, equal: bool) -> None:
    assert stated.equals(printed) is equal


def printing(tmp_path: Path, check: Check, *texts: str) -> Outputs:
    """The check's commands have printed these texts."""
    outputs = Outputs(tmp_path, 60.0)
    outputs.known = dict(zip(check.commands, texts, strict=True))
    return outputs


def test_lines_are_found_in_the_output(tmp_path: Path) -> None:
    (check,) = checks(PAGE)
    outputs = printing(tmp_path, check, "trot  6  3.11 rad\n", "walk 1\nrows  of all 29403\n")
    assert list(compared(check, outputs)) == [
        (6, "3.09", "differs: the command prints 3.11"),
        (7, "29 403", "equal"),
    ]
    assert not list(unsourced(PAGE))


def test_a_number_stands_in_the_line_of_which_most_are_equal(tmp_path: Path) -> None:
    """Two rows of one form: the number in front tells them apart."""
    page = PAGE.replace("trot * {3.09} rad\nrows ... all {29 403}", "{3.09} 1 {29 403}")
    (check,) = checks(page)
    rows = printing(tmp_path, check, "1.00  1  500\n3.09  1  29403\n", "")
    assert [outcome for *_, outcome in compared(check, rows)] == ["equal", "equal"]
    rows = printing(tmp_path, check, "1.00  1  500\n3.09  1  29404\n", "")
    assert [outcome for *_, outcome in compared(check, rows)] == [
        "equal",
        "differs: the command prints 29404",
    ]


def test_a_line_that_is_gone_differs(tmp_path: Path) -> None:
    (check,) = checks(PAGE)
    outcomes = {outcome for _, _, outcome in compared(check, printing(tmp_path, check, "a trot", ""))}
    assert outcomes == {"differs: the command prints no such line"}


@pytest.mark.parametrize(
    "command",
    ["rm -r results", "python -c pass", "python -m pytest", "python -m pytest ../x.py", "gaitsweepx run"],
)
def test_other_commands_are_refused(command: str) -> None:
    with pytest.raises(ValueError, match="only `gaitsweep"):
        list(checks(f"1\n\n<!-- numbers: {command}\n{{1}}\n-->\n"))


def test_a_number_that_the_page_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match=r"3\.1 does not stand"):
        list(checks(PAGE.replace("{3.09}", "{3.1}")))


def test_a_number_may_come_from_a_file_or_a_publication_or_another_machine() -> None:
    page = (
        "At most 150 cycles, 3.1 rad in the paper, 1.29e10 attempts/s, 2.5 s.\n\n"
        "<!-- numbers given, sweeps/quick_basins.yaml: {150} -->\n"
        "<!-- numbers given, Aoi 2011, Fig. 6: {3.1} -->\n"
        "<!-- numbers recorded, one H100, 5248054: python -m benchmarks.card_alone\n{1.29e10}\n-->\n"
    )
    assert list(sourced(page)) == [("given", "150"), ("given", "3.1"), ("recorded", "1.29e10")]
    assert list(unsourced(page)) == [(1, "2.5")]
    with pytest.raises(ValueError, match=r"3\.1 is not in sweeps/quick_basins\.yaml"):
        list(sourced(page.replace("Aoi 2011, Fig. 6", "sweeps/quick_basins.yaml")))
    with pytest.raises(ValueError, match=r"there is no sweeps/basins\.yaml"):
        list(sourced(page.replace("sweeps/quick_basins.yaml", "sweeps/basins.yaml")))
    with pytest.raises(ValueError, match=r"3\.2 does not stand"):
        list(sourced(page.replace("{3.1}", "{3.2}")))


def test_long_commands_are_not_run(tmp_path: Path) -> None:
    (check,) = checks(PAGE.replace("numbers:", "numbers, 240 s:"))
    assert {each[2] for each in compared(check, Outputs(tmp_path, 60.0))} == {"not run: takes 240 s"}


def test_any_text_right_before_a_number_is_refused() -> None:
    """It could end at any number of the line."""
    with pytest.raises(ValueError, match="a word between"):
        list(checks(PAGE.replace("all {", "{")))


@pytest.mark.slow
def test_a_command_that_fails_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text("15625\n\n<!-- numbers: gaitsweep examples && gaitsweep info nowhere\n{15625}\n-->\n")
    monkeypatch.setattr("sys.argv", ["docs_numbers", "--page", str(page)])
    assert main() == 1
    assert "differs: exit code 2: " in capsys.readouterr().out


@functools.cache
def _program() -> Any:
    """The commands, which take a moment to build."""
    return typer.main.get_command(app)


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_commands_of_the_pages_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert list(unsourced(text)) == []
    assert len(list(checks(text))) == len(re.findall("<!-- numbers[,:]", text))
    for check in checks(text):
        made: set[str] = set()  # by the commands before
        for words in check.commands:
            if words[:3] == ("python", "-m", "pytest"):
                assert (ROOT / words[-1]).is_file(), words
                continue
            if words[0] == "python":
                assert importlib.util.find_spec(words[2]), words
                continue
            command, rest = _program(), list(words[1:])
            while isinstance(command, TyperGroup):
                command = command.commands[rest.pop(0)]
            given = command.make_context(
                command.name, rest
            ).params  # an option that does not exist is an error
            if words[1] in ("run", "search", "sensitivity"):
                job = yaml.safe_load((ROOT / given["job_file"]).read_text(encoding="utf-8"))
                made.add(str(given["out"] or f"results/{job['name']}"))
            assert {word for word in words if re.match("results/", word)} <= made, words
