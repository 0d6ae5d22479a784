"""Data frames of the records of parts, their categorical columns, and the long lists of their `.attrs`."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from numpy.typing import ArrayLike

from gaitsweep import near_miss
from gaitsweep.status import Outcome, Status
from gaitsweep.table.atomic_files import TableError
from gaitsweep.table.manifest import TABLE
from gaitsweep.table.parquet_parts import Footer

_LONG = 64  # items of a list that copies of a table share
_IMMUTABLE = {int, float, str, bool, type(None)}


@dataclasses.dataclass
class _Part:
    """Records of a part: its columns, and the names of the codes that categorical columns have."""

    length: int
    columns: dict[str, np.ndarray | pa.ChunkedArray]
    categories: dict[str, list[str]]


class PartRecords:
    """Parts in order; numeric columns of all parts are read into one array, without copies.

    Args:
        n_rows: the number of rows of the table; with the first part, it gives the number of records.
    """

    def __init__(self, n_rows: int) -> None:
        self._n_rows = n_rows
        self._room = 0
        self._full_columns: dict[str, np.ndarray] = {}
        self.parts: list[_Part] = []
        self.length = 0

    def add(self, table: pa.Table, footer: Footer, records_per_row: float = 1.0) -> None:
        """Add the records of a part.

        Args:
            table: the records.
            footer: the part's footer.
            records_per_row: about how many records a row has.
        """
        self._room = self._room or math.ceil(records_per_row * self._n_rows)
        columns: dict[str, np.ndarray | pa.ChunkedArray] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            if name in footer.categories:
                columns[name] = self._placed(name, _codes(column, footer.categories[name]))
            elif pa.types.is_floating(column.type) or (
                pa.types.is_integer(column.type) and not column.null_count
            ):
                columns[name] = self._placed(name, column.to_numpy())
            else:  # text, flags, and whole numbers of which some are missing
                columns[name] = column
        self.parts.append(_Part(table.num_rows, columns, footer.categories))
        self.length += table.num_rows

    def _placed(self, name: str, values: np.ndarray) -> np.ndarray:
        """Copy values to their place in the full column, if they fit; return the copy."""
        if name not in self._full_columns:
            self._full_columns[name] = np.empty(self._room, values.dtype)
        full_column = self._full_columns[name]
        place = full_column[self.length : self.length + len(values)]
        if full_column.dtype != values.dtype or len(place) != len(values):
            return np.array(values)
        place[:] = values
        return place

    def full_column(self, name: str) -> np.ndarray | None:
        """Return the column of all parts, if all have their values there, else None."""
        full_column = self._full_columns.get(name)
        if full_column is None:
            return None
        for part in self.parts:
            column = part.columns.get(name)
            if not isinstance(column, np.ndarray) or column.base is not full_column:
                return None
        return full_column[: self.length]


def joined_parts(path: Path, parts: PartRecords, columns: Sequence[str] | None) -> pd.DataFrame:
    """Join the records of all parts.

    Args:
        path: the result directory, for messages.
        parts: the records.
        columns: the names of the columns, in their order; all by default.

    Raises:
        TableError: there is no such column, or the types of a column do not fit together.
    """
    names = list(dict.fromkeys(name for part in parts.parts for name in part.columns))
    values: dict[str, Any] = {}
    for name in names if columns is None else dict.fromkeys(columns):
        if name not in names:
            raise TableError(f"{name} is not a column of {path}{_near_column(path, name)}")
        try:
            values[name] = _joined(name, parts)
        except pa.ArrowException as error:
            raise TableError(
                f"The parts of {path} do not fit together ({' '.join(str(error).split())}): "
                "different versions wrote them. Run its job into another directory."
            ) from error
    return pd.DataFrame(values, index=pd.RangeIndex(parts.length), copy=False)


def outcomes(gait: pd.Categorical, status: ArrayLike) -> pd.Categorical:
    """Return the column `outcome`: the gait of each row (n,), or the reason why it has none."""
    names = list(dict.fromkeys([*gait.categories, *map(str, Outcome)]))
    codes = np.where(gait.codes < 0, names.index(Outcome.NO_GAIT), gait.codes.astype(np.int32))
    codes[~Status.SOUND.among(status)] = names.index(Outcome.FAILED)
    codes[Status.UNDECIDED.among(status)] = names.index(Outcome.NOT_SETTLED)
    return categorical(codes, names)


def categorical(codes: ArrayLike, names: Sequence[str]) -> pd.Categorical:
    """Return the names of codes (n,); -1 has no name."""
    return pd.Categorical.from_codes(codes, dtype=_categories(tuple(names)))


# cached, since pandas takes longer to look for repeated names than a small column takes
@functools.lru_cache(maxsize=256)
def _categories(names: tuple[str, ...]) -> pd.CategoricalDtype:
    """Return the type of a column with these categories."""
    return pd.CategoricalDtype(list(names))


class SharedList(list[Any]):
    """A long list of numbers and words, which copies of a table share.

    pandas copies `.attrs` deeply in each operation on a table: the values of a long axis, number by number,
    took more time than the operation.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> SharedList:
        return self


# a job in `.attrs` can be written as YAML
yaml.representer.SafeRepresenter.add_representer(SharedList, yaml.representer.SafeRepresenter.represent_list)


def with_shared_lists(value: Any) -> Any:
    """Return a JSON value whose long lists of numbers and words are a `SharedList`."""
    if isinstance(value, dict):
        return {name: with_shared_lists(item) for name, item in value.items()}
    if not isinstance(value, list):
        return value
    if len(value) > _LONG and set(map(type, value)) <= _IMMUTABLE:
        return SharedList(value)
    return [with_shared_lists(item) for item in value]


def _near_column(path: Path, name: str) -> str:
    """Return the end of the message about an unknown column."""
    file = next(iter(sorted((path / TABLE).glob("part-*.parquet"))))
    return near_miss.suggestion(name, pq.read_schema(file).names)


def _joined(name: str, parts: PartRecords) -> Any:
    """Join a column of all parts: categorical, an array, or a series."""
    full_column = parts.full_column(name)
    if not any(name in part.categories for part in parts.parts):
        return _promoted(name, parts.parts) if full_column is None else full_column
    categories = list(dict.fromkeys(text for part in parts.parts for text in part.categories.get(name, ())))
    if full_column is None or any(part.categories[name] != categories for part in parts.parts):
        full_column = np.concatenate([_recoded(name, part, categories) for part in parts.parts])
    return categorical(full_column, categories)


def _recoded(name: str, part: _Part, categories: list[str]) -> np.ndarray:
    """Return the codes (n,) of a part's column among the categories of all parts."""
    column = part.columns.get(name)
    if column is None:
        return np.full(part.length, -1, _narrow(categories))
    if isinstance(column, pa.ChunkedArray):
        return _codes(column, categories)
    codes = [*map(categories.index, part.categories[name]), -1]
    return np.array(codes, _narrow(categories))[column]


def _promoted(name: str, parts: list[_Part]) -> pd.Series:
    """Join a column of text or flags, or one whose type differs between parts of different versions."""
    pieces = [_in_arrow(part.columns.get(name, pa.nulls(part.length))) for part in parts]
    kinds = [pa.schema([pa.field(name, piece.type)]) for piece in pieces]
    common = pa.unify_schemas(kinds, promote_options="permissive").types[0]
    chunks = [chunk.cast(common) for piece in pieces for chunk in piece.chunks]
    return pa.chunked_array(chunks, common).to_pandas()


def _in_arrow(piece: np.ndarray | pa.Array | pa.ChunkedArray) -> pa.ChunkedArray:
    """Convert a column of a part, which may be missing or in NumPy's memory, to an array of Arrow."""
    return piece if isinstance(piece, pa.ChunkedArray) else pa.chunked_array([pa.array(piece)])


def _narrow(categories: list[str]) -> np.dtype[Any]:
    """Return the smallest integer type for codes of categories, as in pandas."""
    return np.min_scalar_type(-max(len(categories), 1))


def _codes(column: pa.ChunkedArray, categories: list[str]) -> np.ndarray:
    """Return the index of each name among the categories, -1 for missing names."""
    place = {name: number for number, name in enumerate(categories)}
    codes = [np.zeros(0, _narrow(categories))]
    for chunk in column.chunks:
        encoded = chunk if pa.types.is_dictionary(chunk.type) else chunk.dictionary_encode()
        names = encoded.dictionary.to_pylist()
        code_of_name = np.array([*(place.get(name, -1) for name in names), -1], _narrow(categories))
        codes.append(code_of_name[encoded.indices.fill_null(-1).to_numpy()])
    return np.concatenate(codes)
