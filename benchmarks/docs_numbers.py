"""Whether the commands that pages name still print the pages' numbers: `python -m benchmarks.docs_numbers`.

A comment after a paragraph or table names a command and, a line each, what it prints:

    <!-- numbers: gaitsweep run sweeps/quick_basins.yaml && gaitsweep info results/quick_basins
    rows {300} of 300, complete
    -->

`{300}` stands for a number of the page, which has to stand between the last heading and the comment. Other
text is the output's own, `*` is any word and `...` any text. Equal is what rounds to the page's digits;
`{24 +- 3}` gives another tolerance, `{<1e-6}` an upper bound, `{15.0 %}` a percentage of which the command
prints the fraction.

Commands run in a temporary folder, each once, and those of `--jobs` comments at a time. One that takes longer
than `--limit` is stopped, and those of `<!-- numbers, 240 s: ` do not begin where this time is above it.
`--folder DIR` keeps their results: what is complete there is not run again.

Two more comments say where a number comes from that no command prints here: a setting of a file or a value of
a publication, and a measurement on another machine, with its command.

    <!-- numbers given, sweeps/quick_basins.yaml: {0.7} {300} -->
    <!-- numbers given, Ambe 2021, Fig. 4: {0.51} -->
    <!-- numbers recorded, one H100, 5248054: python -m benchmarks.card_alone
    {1.29e10} {8.30e9}
    -->

Each has to stand in the section, and those of a file in that file too. `--missing` lists the numbers that
look measured (three digits, a point, an exponent, %) and have no comment.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import dataclasses
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

_COMMENT = re.compile(r"^<!-- numbers(?:, (\d+) s)?: (.*?)^-->$", re.MULTILINE | re.DOTALL)
_SOURCED = re.compile(r"^<!-- numbers (given|recorded), ([^:\n]*): (.*?)-->$", re.MULTILINE | re.DOTALL)
_HEADING = re.compile(r"^#+ .*$", re.MULTILINE)
_GENERATED = re.compile(r"^<!-- described: (\w+) -->$.*?^<!-- end: \1 -->$", re.MULTILINE | re.DOTALL)
_NUMBER = r"-?(?:\d+(?:\.\d+)?|\.\d+)(?:e[-+]?\d+)?"
_GROUPED = r"-?\d{1,3}(?:[ \n]\d{3})+(?![\d.])"
_BRACES = re.compile(rf"\{{(<?) ?({_GROUPED}|{_NUMBER})(?: \+- ({_NUMBER}))?( %)?\}}")
# Not measured: code, addresses of links, and what a number only names.
_UNMEASURED = re.compile(
    r"```.*?```|`[^`]*`|\]\([^)]*\)|(?:Figs?\.|Tables?|Sec\.|eqs?\.|Eqs?\.|et al\.) ?"
    r"\(?\d+(?:\.\d+)*[a-z]?\b\)?(?:(?:, | and | to )\(?\d+[a-z]?\b(?!\.\d)\)?)*"
    r"|^(?:#+ |- )?\d+\. |\$[^$]*\$|[\w:]*:\d+\b|95 %(?= (?:confidence )?intervals?)",
    re.DOTALL | re.MULTILINE,
)
_WRITTEN = re.compile(rf"(?<![\w.:/-])(?:{_GROUPED}|{_NUMBER})(?![\w/])")


@dataclasses.dataclass(frozen=True)
class Stated:
    """A number of a page: its digits there, and which values of the command are equal to it."""

    digits: str
    tolerance: str = ""
    bound: bool = False
    percent: bool = False

    def equals(self, printed: str) -> bool:
        """Whether a number that a command printed is this one."""
        value, stated = float(_plain(printed)) * (100.0 if self.percent else 1.0), float(_plain(self.digits))
        if self.bound:
            return value <= stated
        mantissa, _, exponent = _plain(self.digits).partition("e")
        last = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
        tolerance = float(self.tolerance) if self.tolerance else 0.5 * last
        return abs(value - stated) <= tolerance + 1e-12 * abs(stated)


@dataclasses.dataclass(frozen=True)
class Line:
    """A line of output as a page has it; `number` is that of the line in the page."""

    number: int
    stated: tuple[Stated, ...]
    pattern: re.Pattern[str]


@dataclasses.dataclass(frozen=True)
class Check:
    """Commands, as words, the seconds that a page says they take, and the lines of output that it reports."""

    commands: tuple[tuple[str, ...], ...]
    seconds: int
    lines: tuple[Line, ...]


def pages() -> list[Path]:
    """README and the pages of the documentation."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def checks(text: str) -> Iterator[Check]:
    """The checks of a page.

    Raises:
        ValueError: for a command that is not allowed, and a line without a number of the section before it.
    """
    for comment in _COMMENT.finditer(text):
        before, section = text[: comment.start()], _section(text, comment.start())
        first, *rest = comment[2].replace("\\\n", " ").splitlines()
        begin = before.count("\n") + 2 + comment[2].count("\\\n")
        lines = tuple(_line(begin + i, line, section) for i, line in enumerate(rest))
        yield Check(tuple(map(_command, first.split(" && "))), int(comment[1] or 0), lines)


def sourced(text: str) -> Iterator[tuple[str, str]]:
    """The numbers of a page whose comment names a source: its kind, `given` or `recorded`, and the digits.

    Raises:
        ValueError: a number is not in the section, or not in the file that is its source.
    """
    for comment in _SOURCED.finditer(text):
        kind, source, numbers = comment.groups()
        line = text.count("\n", 0, comment.start()) + 1
        section = _section(text, comment.start())
        if kind == "recorded":
            _command(numbers.replace("\\\n", " ").splitlines()[0])
        results = [" ".join(braces[2].split()) for braces in _BRACES.finditer(numbers)]
        if not results:
            raise ValueError(f"line {line}: no number in braces")
        file = ROOT / source
        if kind == "given" and "/" in source and not file.is_file():
            raise ValueError(f"line {line}: there is no {source}")
        written = re.sub(r"(?<=\d)_(?=\d)", "", file.read_text()) if file.is_file() else ""
        numbers_of_file = {float(_plain(number)) for number in re.findall(_NUMBER, written)}
        for digits in results:
            _must_stand(digits, section, line)
            if file.is_file() and float(_plain(digits)) not in numbers_of_file:
                raise ValueError(f"line {line}: {digits} is not in {source}")
            yield kind, digits


def unsourced(text: str) -> Iterator[tuple[int, str]]:
    """The numbers of a page that look measured and have no comment, with their lines."""
    known = {stated.digits for check in checks(text) for line in check.lines for stated in line.stated}
    known |= {digits for _, digits in sourced(text)}
    prose = text
    for pattern in (_SOURCED, _COMMENT, _GENERATED, _UNMEASURED):
        prose = pattern.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), prose)
    for written in _WRITTEN.finditer(prose):
        digits = " ".join(written[0].split())
        year = re.fullmatch(r"(19|20)\d\d", digits)
        measured = len(re.sub(r"\D", "", digits)) > 2 or re.search(r"[.e]", digits)
        measured = measured or prose[written.end() : written.end() + 2] == " %"
        if measured and not year and digits not in known:
            yield prose.count("\n", 0, written.start()) + 1, digits


class Outputs:
    """Output of commands in one folder; each runs once."""

    def __init__(self, folder: Path, limit: float) -> None:
        self.folder, self.limit = folder, limit
        self.known: dict[tuple[str, ...], str | OSError] = {}
        self.locks: defaultdict[tuple[str, ...], threading.Lock] = defaultdict(threading.Lock)
        for name in ("sweeps", "configs"):
            if not (folder / name).exists():
                (folder / name).symlink_to(ROOT / name)

    def of(self, commands: tuple[tuple[str, ...], ...]) -> str:
        """Output of commands, one after the other.

        Raises:
            TimeoutError: one took longer than the limit.
            ChildProcessError: one failed.
        """
        text = ""
        for command in commands:
            with self.locks[command]:
                if command not in self.known:
                    self.known[command] = self._run(command)
            if isinstance(printed := self.known[command], OSError):
                raise printed
            text += printed
        return text

    def _run(self, command: tuple[str, ...]) -> str | OSError:
        words = [sys.executable, "-m", *(command[2:] if command[0] == "python" else command)]
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = os.environ | {"PYTHONPATH": path, "COLUMNS": "200"}
        place = ROOT if words[2] == "pytest" else self.folder
        with subprocess.Popen(
            words, cwd=place, env=environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
        ) as process:  # fmt: skip
            try:
                printed, _ = process.communicate(timeout=self.limit)
            except subprocess.TimeoutExpired:
                return TimeoutError(f"longer than {self.limit:g} s")
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)  # its workers too
        if process.returncode:
            last = (printed.strip().splitlines() or [""])[-1]
            return ChildProcessError(f"exit code {process.returncode}: {last}")
        return printed


def compared(check: Check, outputs: Outputs) -> Iterator[tuple[int, str, str]]:
    """For each number of a check its line in the page, its digits, and the outcome in words."""
    try:
        if check.seconds > outputs.limit:
            raise TimeoutError(f"takes {check.seconds} s")
        printed, problem = outputs.of(check.commands), ""
    except TimeoutError as error:
        printed, problem = "", f"not run: {error}"
    except ChildProcessError as error:
        printed, problem = "", f"differs: {error}"
    for line in check.lines:
        equal = _most_equal(line, printed)
        for i, stated in enumerate(line.stated):
            if problem or not equal:
                outcome = problem or "differs: the command prints no such line"
            else:
                outcome = equal[i]
            yield line.number, stated.digits, outcome


def _most_equal(line: Line, printed: str) -> list[str]:
    """The outcomes of a line's numbers, by the first line of the output in which most of them are equal."""
    outcomes = [
        [
            "equal" if stated.equals(number) else f"differs: the command prints {number}"
            for stated, number in zip(line.stated, match.groups(), strict=True)
        ]
        for match in filter(None, map(line.pattern.search, printed.splitlines()))
    ]
    return max(outcomes, key=lambda of_line: of_line.count("equal"), default=[])


def main() -> int:
    """Compare, and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--page", type=Path, action="append", help="only this page; may be repeated")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds of a command (60)")
    parser.add_argument("--jobs", type=int, default=1, help="comments whose commands run at a time (1)")
    parser.add_argument("--folder", type=Path, help="keep the results there (a temporary folder)")
    parser.add_argument("--missing", action="store_true", help="run nothing; list numbers without a comment")
    parser.add_argument("--list", action="store_true", help="run nothing; count what has a command")
    options = parser.parse_args()
    outcomes: list[str] = []
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as temporary:
        to_run: list[tuple[str, Check]] = []
        folder: Path = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        outputs = Outputs(folder.resolve(), options.limit)
        for page in options.page or pages():
            text, name = page.read_text(encoding="utf-8"), os.path.relpath(page, ROOT)
            try:
                named, sources = list(checks(text)), [kind for kind, _ in sourced(text)]
                missing = list(unsourced(text))
            except ValueError as error:
                parser.error(f"{name}, {error}")
            if options.missing:
                lines = text.splitlines()
                for line, digits in missing:
                    print(f"{name}:{line}: {digits} in {lines[line - 1].strip()}")
                continue
            if options.list:
                stated = sum(len(line.stated) for check in named for line in check.lines)
                with_source, recorded = sources.count("given"), sources.count("recorded")
                print(
                    f"{name:28} {stated:4} by a command, {with_source:4} given, {recorded:4} recorded, "
                    f"{len(missing):4} without a comment"
                )
                continue
            to_run += [(name, check) for check in named]
        with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
            results = pool.map(lambda named: list(compared(named[1], outputs)), to_run)
            for (name, _), numbers in zip(to_run, results, strict=True):
                for number, digits, outcome in numbers:
                    print(f"{name}:{number}: {digits} {outcome}", flush=True)
                    outcomes.append(outcome.partition(":")[0])
    if not (options.list or options.missing):
        counts = ", ".join(f"{outcomes.count(kind)} {kind}" for kind in ("equal", "differs", "not run"))
        print(f"{len(outcomes)} numbers: {counts}, in {time.perf_counter() - began:.0f} s")
    return int("differs" in outcomes)


def _plain(digits: str) -> str:
    return re.sub(r"\s", "", digits)


def _without_code(text: str) -> str:
    """A page whose blocks of code are blank, so that comments in them are no headings; as long as before."""
    return re.sub(r"```.*?```", lambda block: " " * len(block[0]), text, flags=re.DOTALL)


def _section(text: str, end: int) -> str:
    """The text between the last heading before a comment and the comment, without other comments."""
    before = text[:end]
    headings = [heading.end() for heading in _HEADING.finditer(_without_code(before))]
    return _SOURCED.sub("", _COMMENT.sub("", before[headings[-1] if headings else 0 :]))


def _must_stand(digits: str, section: str, line: int) -> None:
    written = rf"(?<![\d.]){re.escape(digits)}(?!\.?\d)".replace("\\ ", r"\s")
    if not re.search(written, section):
        raise ValueError(f"line {line}: {digits} does not stand between the heading and the comment")


def _command(text: str) -> tuple[str, ...]:
    """The words of a command.

    Raises:
        ValueError: neither gaitsweep nor a module of benchmarks/ nor a file of tests.
    """
    words = shlex.split(text)
    module = words[2] if words[:2] == ["python", "-m"] and len(words) > 2 else ""
    tested = module == "pytest" and re.fullmatch(r"tests(/[a-z_]+)+\.py", words[-1])
    if words[:1] != ["gaitsweep"] and not tested and not re.fullmatch(r"benchmarks(\.[a-z_]+)+", module):
        raise ValueError(
            f"{text}: only `gaitsweep ...`, `python -m benchmarks...` and `python -m pytest ... FILE` are run"
        )
    return tuple(words)


def _line(number: int, text: str, section: str) -> Line:
    stated, pattern, end = [], "", 0
    for braces in _BRACES.finditer(text):
        bound, digits, tolerance, percent = braces.groups()
        _must_stand(digits, section, number)
        stated.append(Stated(digits, tolerance or "", bool(bound), bool(percent)))
        number_there = rf"({_GROUPED}|{_NUMBER})" if " " in digits else f"({_NUMBER})"
        pattern += _literal(text[end : braces.start()]) + number_there
        end = braces.end()
    if not stated or re.search(r"\.\.\. *\{", text):
        raise ValueError(f"line {number}: wanted is a number in braces, and a word between `...` and it")
    return Line(number, tuple(stated), re.compile(r"(?<!\S)" + pattern + _literal(text[end:])))


def _literal(text: str) -> str:
    words = {"...": ".*?", "*": r"\S+"}
    return r"\s+".join(words.get(word) or re.escape(word) for word in re.split(r"\s+", text))


if __name__ == "__main__":
    sys.exit(main())
