"""Reading and repair of damaged result directories: `python -m benchmarks.reliability.damage`.

Files of small, real tables are damaged at random: bits flipped, files cut short, parts put in each other's
place and into other directories. Counted is how many were read as data without a word, how many were named
by their file, and how many `run` mended to the bit. One wrong in silence, unnamed or unmended fails.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

import gaitsweep as gs
from gaitsweep.table import Snapshot, TableError
from gaitsweep.view.report import write_report

TURN = 2 * np.pi
KINDS = ("flip", "truncate", "swap within", "swap between", "flip elsewhere")


@dataclasses.dataclass(frozen=True)
class Case:
    """A job, the directory of its whole table, and that table."""

    job: gs.Job
    path: Path
    table: pd.DataFrame


def cases(folder: Path) -> list[Case]:
    """Run three jobs of the reduced chain, of one record a row and of many."""
    vary = {"psi_1": {"linspace": [0, TURN, 6], "at": "centre"}, "m_B": [0.7, 0.9]}
    runs = {
        "settle": {"kind": "settle", "max_cycles": 30},
        "other": {"kind": "settle", "max_cycles": 31},
        "cycles": {"kind": "return_map", "crossings": 20},
    }
    made = []
    for name, run in runs.items():
        job = gs.Job(
            name=name,
            model="multilegged_reduced",
            start={"psi_2": 2.0, "psi_3": 3.0},
            vary=vary,
            run=run,
            engine={"block": 4, "name": "xla"},
        )
        path = gs.run(job, folder / name).path
        made.append(Case(job, path, gs.load(path)))
    return made


def damage(random: np.random.Generator, kind: str, case: Case, others: list[Case], path: Path) -> list[Path]:
    """Damage the copy of a case's directory; the files that are not as they were."""
    parts = sorted((path / "table").iterdir())
    one = parts[random.integers(len(parts))]
    if kind == "flip":
        flip(random, one)
    elif kind == "truncate":
        data = one.read_bytes()
        one.write_bytes(data[: random.integers(len(data))])
    elif kind == "swap within":
        i, j = random.choice(len(parts), 2, replace=False)
        first, second = parts[i].read_bytes(), parts[j].read_bytes()
        parts[i].write_bytes(second)
        parts[j].write_bytes(first)
        return [parts[i], parts[j]]
    elif kind == "swap between":
        other = others[random.integers(len(others))]
        strangers = sorted((other.path / "table").iterdir())
        one.write_bytes(strangers[random.integers(len(strangers))].read_bytes())
    else:
        names = ("manifest.json", "job.yaml", "SHA256SUMS")
        one = path / names[random.integers(len(names))]
        flip(random, one)
    return [one]


def flip(random: np.random.Generator, file: Path) -> None:
    """Turn one bit of a file around."""
    data = bytearray(file.read_bytes())
    data[random.integers(len(data))] ^= 1 << int(random.integers(8))
    file.write_bytes(bytes(data))


def same(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Whether two tables are equal to the bit, and so is what `.attrs` says of their columns."""
    try:
        pd.testing.assert_frame_equal(one, other, check_exact=True)
    except AssertionError:
        return False
    names = ("job", "quantities")
    return all(one.attrs[name] == other.attrs[name] for name in names)


@dataclasses.dataclass
class Outcome:
    """Result of one damage."""

    silent: bool = False  # a table was read, and it is not the one that was written
    harmless: bool = False  # the table that was written was read
    named: bool = False
    mended: bool = False


def tried(case: Case, path: Path, files: list[Path]) -> Outcome:
    """Read a damaged directory by every way there is, then run its job again."""
    outcome = Outcome()
    messages: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            outcome.harmless = same(gs.load(path), case.table)
            outcome.silent = not outcome.harmless
        except TableError as error:
            messages.append(str(error))
        for look in (Snapshot.of, write_report):
            try:
                result = look(path)
                if isinstance(result, Snapshot):
                    messages.extend(
                        fault.sentence for fault in (*result.files.faults.values(), *result.files.strangers)
                    )
            except TableError as error:
                messages.append(str(error))
    messages.extend(str(warning.message) for warning in caught)
    outcome.named = all(any(file.name in text for text in messages) for file in files)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gs.run(case.job, path)
        outcome.mended = same(gs.load(path), case.table) and gs.Result(path).manifest["complete"]
        outcome.mended &= not Snapshot.of(path).files.faults and not Snapshot.of(path).job_edited
    return outcome


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    counts: dict[str, collections.Counter[str]] = {kind: collections.Counter() for kind in KINDS}
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        known = cases(Path(folder))
        for trial in range(options.trials):
            kind = KINDS[trial % len(KINDS)]
            case = known[random.integers(len(known))]
            path = Path(folder) / "damaged"
            shutil.copytree(case.path, path)
            files = damage(random, kind, case, [other for other in known if other is not case], path)
            outcome = tried(case, path, files)
            shutil.rmtree(path)
            counts[kind].update(trials=1, **dataclasses.asdict(outcome))
            wrong = outcome.silent or not outcome.mended or not (outcome.named or outcome.harmless)
            wrong |= kind != "flip elsewhere" and not outcome.named
            if wrong:
                bad += 1
                print(f"trial {trial}, {kind}, {[file.name for file in files]}: {outcome}", file=sys.stderr)
    columns = ("trials", "silent", "harmless", "named", "mended")
    print(f"{'damage':<16}" + "".join(f"{column:>10}" for column in columns))
    for kind in KINDS:
        print(f"{kind:<16}" + "".join(f"{counts[kind][column]:>10}" for column in columns))
    total = sum(counts.values(), collections.Counter())
    print(f"{'all':<16}" + "".join(f"{total[column]:>10}" for column in columns))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
