"""Reading a result directory: what it holds so far, and its table as a data frame."""

from __future__ import annotations

import collections
import dataclasses
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import yaml

from gaitsweep.table.files import TableError
from gaitsweep.table.manifest import FIGURES, JOB, TABLE, read_manifest
from gaitsweep.table.parts import DamagedPart, Footer, part_name, part_numbers, read_footer, read_records


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """What a result directory held at one moment, read without its records; a run may be writing it.

    `footers` are by block; `damaged` lists the blocks whose part cannot be read.
    """

    path: Path
    job: dict[str, Any]
    manifest: dict[str, Any]
    footers: dict[int, Footer]
    damaged: tuple[int, ...]

    @classmethod
    def of(cls, path: str | Path) -> Snapshot:
        """Look at a result directory.

        Raises:
            TableError: it is none.
        """
        path = Path(path)
        manifest = read_manifest(path)
        try:
            job = yaml.safe_load((path / JOB).read_text(encoding="utf-8"))
        except FileNotFoundError:
            job = {}
        except (OSError, ValueError, yaml.YAMLError) as error:
            raise TableError(f"{path / JOB} cannot be read: {' '.join(str(error).split())}.") from error
        footers: dict[int, Footer] = {}
        damaged: list[int] = []
        for number in part_numbers(path / TABLE):
            try:
                footers[number] = read_footer(path / TABLE / part_name(number))
            except FileNotFoundError:
                continue
            except DamagedPart:
                damaged.append(number)
        return cls(path, job if isinstance(job, dict) else {}, manifest, footers, tuple(damaged))

    @property
    def counts(self) -> dict[str, int]:
        """Finished rows by status."""
        return add_counts(self.footers)

    @property
    def rows_done(self) -> int:
        """How many rows of the sweep stand in complete parts."""
        return sum(footer.rows for footer in self.footers.values())

    @property
    def table_folder(self) -> Path:
        """Where the parts stand."""
        return self.path / TABLE

    @property
    def figures(self) -> list[Path]:
        """The figures that have been drawn, by name."""
        return sorted((self.path / FIGURES).glob("*.png"))

    @property
    def complete(self) -> bool:
        """Whether every row is there."""
        return self.rows_done == self.manifest["rows"]


def add_counts(footers: dict[int, Footer]) -> dict[str, int]:
    """Add up the statuses of parts, the most frequent first."""
    total: collections.Counter[str] = collections.Counter()
    for footer in footers.values():
        total.update(footer.counts)
    return dict(sorted(total.items(), key=lambda item: (-item[1], item[0])))


def load(path: str | Path) -> pd.DataFrame:
    """Read the table of a result directory, complete or not, in the order of its rows.

    `.attrs` holds `job` and `manifest` (dicts), `quantities` (unit, meaning and symbol by name), `path` and
    `complete` (whether every row is there).

    Args:
        path: the directory.

    Returns:
        One record a row, or a crossing or a sample; `status`, `gait` and other names are categories.

    Raises:
        TableError: it is no result directory, has no finished part yet, or a part of it is damaged.
    """
    snapshot = Snapshot.of(path)
    if snapshot.damaged:
        raise TableError(
            f"{snapshot.table_folder / part_name(snapshot.damaged[0])} is damaged: "
            "run its job again, which makes that part anew."
        )
    if not snapshot.footers:
        raise TableError(f"{snapshot.path} has no finished part yet: run its job until there is one.")
    categories: dict[str, list[str]] = {}
    for footer in snapshot.footers.values():
        for column, names in footer.categories.items():
            known = categories.setdefault(column, [])
            known.extend(name for name in names if name not in known)
    try:
        tables = [
            read_records(snapshot.table_folder / part_name(number), categories)
            for number in sorted(snapshot.footers)
        ]
    except DamagedPart as error:
        raise TableError(
            f"A part of {snapshot.path} is damaged ({error}): remove it and run the job again."
        ) from error
    frame = pa.concat_tables(tables, promote_options="permissive").unify_dictionaries().to_pandas()
    for column, names in categories.items():
        frame[column] = pd.Categorical(frame[column], categories=names)
    frame.attrs.update(
        job=snapshot.job,
        manifest=snapshot.manifest,
        quantities=snapshot.manifest.get("quantities", {}),
        path=str(snapshot.path),
        complete=snapshot.complete,
    )
    return frame
