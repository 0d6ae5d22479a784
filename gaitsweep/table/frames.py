"""Data frames of the records of parts, their categorical columns, and what their `.attrs` hold."""

from __future__ import annotations

import copy
import functools
from collections.abc import Container, Sequence
from pathlib import Path
from typing import Any, NoReturn

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
from gaitsweep.table.parquet_parts import CATEGORICAL, Footer

MOST_SEPARATE = 40  # columns of a table in memory that are not joined to blocks of one type


class PartRecords:
    """The records of parts in order, and the categories of all parts by column."""

    def __init__(self) -> None:
        self.tables: list[pa.Table] = []
        self.categories: dict[str, dict[str, None]] = {}

    def add(self, table: pa.Table, footer: Footer) -> None:
        """Add the records of a part."""
        self.tables.append(table)
        for name, categories in footer.categories.items():
            self.categories.setdefault(name, {}).update(dict.fromkeys(categories))

    @property
    def length(self) -> int:
        """The number of records."""
        return sum(table.num_rows for table in self.tables)


def joined_parts(path: Path, parts: PartRecords, columns: Sequence[str] | None) -> pd.DataFrame:
    """Join the records of all parts, which `parts` then no longer has.

    Args:
        path: the result directory, for messages.
        parts: the records.
        columns: the names of the columns, in their order; all by default.

    Raises:
        TableError: there is no such column, or the types of a column do not fit together.
    """
    known = dict.fromkeys(name for table in parts.tables for name in table.column_names)
    names = list(known if columns is None else dict.fromkeys(columns))
    for name in names:
        if name not in known:
            raise TableError(f"{name} is not a column of {path}{_near_column(path, name)}")
    try:
        encoded = [_encoded(table, names, parts.categories) for table in parts.tables]
        joined = pa.concat_tables(encoded, promote_options="permissive").unify_dictionaries().select(names)
    except pa.ArrowException as error:
        raise TableError(
            f"The parts of {path} do not fit together ({' '.join(str(error).split())}): "
            "different versions wrote them. Run its job into another directory."
        ) from error
    # each column leaves Arrow's memory as it is converted
    parts.tables.clear()
    encoded.clear()
    frame = joined.to_pandas(self_destruct=True)
    for name in names:
        if name in parts.categories:
            # of parts that have such a column as plain text too, whose footers have no categories
            present = frame[name].cat.categories
            categories = list(parts.categories[name] | dict.fromkeys(present))
            if categories != list(present):
                frame[name] = frame[name].cat.set_categories(categories)
            if not categories:  # of objects, in Arrow's frames
                frame[name] = frame[name].astype(_categories(()))
    return frame


def joined_frames(frames: Sequence[pd.DataFrame]) -> pd.DataFrame | None:
    """Join the records of blocks, with the values and types that `joined_parts` gives.

    Args:
        frames: the records of each block.

    Returns:
        The records; None if Arrow would convert a column, or if the blocks have different columns.
    """
    kinds = [list(frame.dtypes.map(_kind_of).items()) for frame in frames]
    if not frames or any(kind != kinds[0] for kind in kinds) or not all(map(_are_as_stored, frames)):
        return None
    for name in frames[0].select_dtypes("category"):
        categories = [list(frame[name].cat.categories) for frame in frames]
        names = list(dict.fromkeys(text for of_frame in categories for text in of_frame))
        if any(of_frame != names for of_frame in categories):
            frames = [frame.assign(**{name: frame[name].cat.set_categories(names)}) for frame in frames]
    return pd.concat(frames, ignore_index=True)


class RowColumns:
    """Columns of a table with one record for each row, which blocks fill in any order.

    They take memory once, where the blocks' own records would have to be joined.

    Args:
        frame: the records of one block, which decide the types.
        rows: the number of rows of the table.
    """

    def __init__(self, frame: pd.DataFrame, rows: int) -> None:
        self._dtypes = dict(frame.dtypes)
        self._columns: dict[Any, np.ndarray] = {}
        if _are_as_stored(frame):
            self._columns = {name: np.empty(rows, _plain(column).dtype) for name, column in frame.items()}

    def fill(self, frame: pd.DataFrame, start: int, stop: int) -> bool:
        """Copy the records of rows `start` to `stop - 1`, and return True; or False if they do not fit.

        They do not fit if a row has several records, or a column or its categories differ.
        """
        dtypes = dict(frame.dtypes)
        if not self._columns or list(dtypes) != list(self._columns) or len(frame) != stop - start:
            return False
        if not all(map(_are_same, dtypes.values(), self._dtypes.values())):
            return False
        for name, column in frame.items():
            self._columns[name][start:stop] = _plain(column)
        return True

    def frame(self, start: int, stop: int, names: Sequence[str] | None = None) -> pd.DataFrame:
        """Return the records of rows `start` to `stop - 1`, without copying the values.

        Args:
            start, stop: the rows.
            names: the columns, of which those are left out that there are not; all by default.
        """
        columns: dict[Any, Any] = {}
        for name in self._columns if names is None else (name for name in names if name in self._columns):
            part, dtype = self._columns[name][start:stop], self._dtypes[name]
            is_text = isinstance(dtype, pd.CategoricalDtype)
            columns[name] = pd.Categorical.from_codes(part, dtype=dtype) if is_text else part
        return pd.DataFrame(columns, copy=False)


def _plain(column: pd.Series) -> np.ndarray:
    """Return the values of a column, or its codes."""
    return column.cat.codes.to_numpy() if isinstance(column.dtype, pd.CategoricalDtype) else column.to_numpy()


def _are_same(dtype: Any, other: Any) -> bool:
    """Return whether two columns have one type, with the same categories in the same order."""
    if isinstance(dtype, pd.CategoricalDtype) and isinstance(other, pd.CategoricalDtype):
        return dtype is other or (dtype == other and list(dtype.categories) == list(other.categories))
    return dtype == other


def _kind_of(dtype: Any) -> Any:
    """Return the type of a column, without the categories of text."""
    return "category" if isinstance(dtype, pd.CategoricalDtype) else dtype


def _are_as_stored(frame: pd.DataFrame) -> bool:
    """Return whether Arrow gives all columns back as they are."""

    def is_as_stored(name: str, dtype: Any) -> bool:
        if isinstance(dtype, pd.CategoricalDtype):
            categories = dtype.categories
            is_text = categories.dtype == _text() and all(type(category) is str for category in categories)
            return is_text and not dtype.ordered
        is_number = isinstance(dtype, np.dtype) and dtype.kind in "iufb" and dtype.isnative
        return is_number and dtype.itemsize <= 8 and name not in CATEGORICAL

    return all(map(is_as_stored, frame.columns, frame.dtypes))


def with_same_categories(frames: Sequence[pd.DataFrame]) -> list[pd.DataFrame]:
    """Return frames in which categorical columns of one name have the same categories in the same order.

    They are those of the first frame, then new ones of the others; outcomes that are no gaits are the last.
    """
    dtypes: dict[str, pd.CategoricalDtype] = {}
    for name in dict.fromkeys(name for frame in frames for name in frame.columns):
        columns = [frame[name] for frame in frames if name in frame.columns]
        if any(isinstance(column.dtype, pd.CategoricalDtype) for column in columns):
            values: dict[Any, None] = {}  # of all frames, in order
            for column in columns:
                categories = getattr(column.dtype, "categories", None)
                values |= dict.fromkeys(column.dropna().unique() if categories is None else categories)
            dtypes[name] = pd.CategoricalDtype(sorted(values, key=lambda value: value in set(Outcome)))
    return [
        frame.astype({name: dtype for name, dtype in dtypes.items() if name in frame.columns})
        for frame in frames
    ]


def _encoded(table: pa.Table, names: Sequence[str], categorical_names: Container[str]) -> pa.Table:
    """The named columns of a part, as far as it has them, with categorical ones dictionary-encoded."""
    columns = {name: table.column(name) for name in names if name in table.column_names}
    for name, column in columns.items():
        if name in categorical_names and not pa.types.is_dictionary(column.type):
            columns[name] = column.cast(pa.string()).dictionary_encode()
    return pa.table(columns)


def outcomes(gait: pd.Categorical, status: ArrayLike) -> pd.Categorical:
    """Return the column `outcome`: the gait of each row (n,), or the reason why it has none."""
    names = list(dict.fromkeys([*gait.categories, *map(str, Outcome)]))
    codes = np.where(gait.codes < 0, names.index(Outcome.NO_GAIT), gait.codes.astype(np.int32))
    is_sound = Status.SOUND.among(status)
    if not is_sound.all():
        codes = np.where(is_sound, codes, names.index(Outcome.FAILED))
        codes = np.where(Status.UNDECIDED.among(status), names.index(Outcome.NOT_SETTLED), codes)
    return categorical(codes, names)


def categorical(codes: ArrayLike, names: Sequence[str]) -> pd.Categorical:
    """Return the names of codes (n,); -1 has no name."""
    return pd.Categorical.from_codes(codes, dtype=_categories(tuple(names)))


@functools.cache
def _text() -> Any:
    """Return the type of categories of text, which depends on the version of pandas."""
    return pd.Index([""]).dtype


# cached, since pandas takes longer to look for repeated names than a small column takes
@functools.lru_cache(maxsize=256)
def _categories(names: tuple[str, ...]) -> pd.CategoricalDtype:
    """Return the type of a column with these categories, of text even if there is none."""
    return pd.CategoricalDtype(pd.Index(names, dtype=_text()))


def _refuse_change(self: Any, *args: Any, **fields: Any) -> NoReturn:
    """Refuse a change of what copies of a table share."""
    raise TypeError(
        "All copies of a table share what its .attrs hold. To change its job, change "
        'copy.deepcopy(table.attrs["job"]) and assign that.'
    )


class SharedList(list[Any]):
    """A list in the `.attrs` of a table; as `SharedDict`."""

    __setitem__ = __delitem__ = __iadd__ = __imul__ = append = extend = _refuse_change
    insert = pop = remove = clear = sort = reverse = _refuse_change

    def __reduce__(self) -> tuple[Any, ...]:
        return list, (list(self),)

    def __deepcopy__(self, memo: dict[int, Any]) -> list[Any]:
        return self if memo else [copy.deepcopy(item) for item in self]


class SharedDict(dict[str, Any]):
    """A mapping in the `.attrs` of a table, which its copies share, so that it cannot be changed.

    pandas copies `.attrs` deeply in each operation on a table, even `table["f"]`: a job and its quantities,
    value by value, took longer than the operation. `copy.deepcopy` of such a mapping by itself, and its copy
    in another process, are plain ones.
    """

    __setitem__ = __delitem__ = __ior__ = update = pop = popitem = setdefault = clear = _refuse_change

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)

    def __deepcopy__(self, memo: dict[int, Any]) -> dict[str, Any]:
        # pandas copies all of `.attrs`, whose copy is then in the memo
        return self if memo else {name: copy.deepcopy(value) for name, value in self.items()}


# a job in `.attrs` can be written as YAML
_REPRESENTERS: tuple[Any, ...] = (yaml.representer.SafeRepresenter, yaml.representer.Representer)
for _representer in _REPRESENTERS:
    _representer.add_representer(SharedList, _representer.represent_list)
    _representer.add_representer(SharedDict, _representer.represent_dict)


def shared(value: Any) -> Any:
    """Make the mappings and lists of a JSON value unchangeable, so that copies of a table share them."""
    if isinstance(value, dict):
        return SharedDict({name: shared(item) for name, item in value.items()})
    if not isinstance(value, list):
        return value
    # an axis may be a list of a million numbers
    return SharedList(value if {dict, list}.isdisjoint(map(type, value)) else map(shared, value))


def _near_column(path: Path, name: str) -> str:
    """Return the end of the message about an unknown column."""
    file = next(iter(sorted((path / TABLE).glob("part-*.parquet"))))
    return near_miss.suggestion(name, pq.read_schema(file).names)
