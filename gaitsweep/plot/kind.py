"""The interface of a kind of figure: its fields, its runs and columns, and its drawing.

`figure_kind` turns a drawing function into a kind; its fields in a job are the function's arguments.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import pkgutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, ParamSpec, cast

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype
from pydantic import Field, create_model

from gaitsweep import near_miss
from gaitsweep.analysis.records import AnalysisError
from gaitsweep.contract import Model, names_gait
from gaitsweep.design import Design
from gaitsweep.errors import warn
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.mathtext import can_be_set
from gaitsweep.plot.arguments import TEXT_COLUMNS, Name, Role, fields_of, parts_of
from gaitsweep.plot.columns import HATCHED, PlotError, is_compared
from gaitsweep.plot.figure_style import STYLE_FIELDS, FigureStyle, current, given_axes, read_style, styled
from gaitsweep.plot.provenance_marks import letter_panels, mark, remarks
from gaitsweep.plot.style_names import StyleNames
from gaitsweep.schema.diagnostics import Diagnostic, Path, dotted, quoted
from gaitsweep.schema.strict_model import Registry, kind_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Coloured = Literal["gaits", "periods", "none"]
Refusal = tuple[Path, str]  # where in the figure, and the end of the sentence
_OUTCOME_COLUMNS = frozenset({"gait", "outcome", "status"})  # whose texts are names of gaits and outcomes
_LOST = (
    "This table has no units and no job in .attrs, which pandas.concat and merge drop: join results by "
    "gs.concat."
)
_TYPESET_FIELDS = ("title", "titles", "points", "intervals", "ticks")  # whose texts may have TeX


@dataclasses.dataclass(frozen=True)
class PlannedTable:
    """The table of a job that has not run yet, for checks of its figures: its rows, run and columns."""

    rows: Design
    run: RunKind
    columns: Sequence[str]

    @property
    def model(self) -> Model:
        """The model of its rows."""
        return self.rows.model

    @property
    def varied(self) -> tuple[str, ...]:
        """The names of the quantities that differ between rows."""
        return self.rows.names

    def missing(self, names: Sequence[str]) -> str | None:
        """The first of the names that is not a column."""
        return next((name for name in names if name not in self.columns), None)

    def unit(self, column: str) -> str:
        """A column's unit, or an empty text."""
        quantities = {c.name: c.quantity for c in self.run.all_columns(self.model) if c.quantity is not None}
        quantities |= {q.name: q for q in (*self.model.parameters, *self.model.initial_conditions)}
        return quantities[column].unit if column in quantities else ""


class FigureKind(FigureStyle):
    """A figure of a job.

    A kind has a field `kind: Literal["its_name"]`, the fields of `FigureStyle`, and may have `title` and
    `name`; its other fields are arguments of `draw`, whose first argument is the table. `check` finds errors
    that the job alone shows; `draw` refuses errors that only the table shows.
    """

    draw: ClassVar[Callable[..., Figure]]
    runs: ClassVar[tuple[str, ...]] = ()  # the kinds of runs that it suits
    column_fields: ClassVar[tuple[str, ...]] = ()  # the fields that name columns of the table
    observable_fields: ClassVar[tuple[str, ...]] = ()  # those that name observables, one or a list
    axis_fields: ClassVar[tuple[str, ...]] = ()  # those that name columns of numbers, drawn along an axis
    added_columns: ClassVar[tuple[str, ...]] = ()  # columns that it adds to the table
    coloured: ClassVar[Coloured] = "gaits"  # the names whose colours have an effect
    gaits_by_default: ClassVar[bool] = False  # whether it colours gaits where `hue` is left out

    @property
    def kind_name(self) -> str:
        """The value of the field `kind`."""
        return kind_of(type(self))

    @classmethod
    def idle_colours(
        cls,
        colours: Mapping[str, str] | None,
        fields: Mapping[str, Any],
        numbers: Collection[str] | None = None,
    ) -> str | None:
        """The end of a sentence about colours of which none or some have no effect; None: all have one.

        Args:
            colours: the colours of a style, by name.
            fields: the figure's own fields, without those that have their default.
            numbers: as those of `colours_of`.
        """
        idle = [name for name in colours or {} if not cls.colours_of(name, fields, numbers)]
        if not idle:
            return None
        kind = kind_of(cls)
        if cls.coloured == "periods":
            return f"has no effect for {', '.join(idle)}: a figure {kind} colours periods (period 1: red)."
        if cls.coloured == "gaits":
            return f"has no effect for {', '.join(idle)}: a figure {kind} colours gaits only with hue: gait."
        return f"has no effect: a figure {kind} does not colour gaits. {kinds_with_gait_colours()}"

    @classmethod
    def colours_of(cls, name: str, fields: Mapping[str, Any], numbers: Collection[str] | None = None) -> bool:
        """Whether the colour of a gait, or of a period, has an effect in a figure with these own fields.

        Args:
            name: the gait, the outcome or the period.
            fields: the figure's own fields, without those that have their default.
            numbers: the numeric columns of its table; by default all columns but those of texts.
        """
        if (field := cls.model_fields.get("hue")) is not None:
            hue = fields.get("hue", field.default)
            if hue is None and cls.gaits_by_default:
                hue = "gait"
            if hue in (None, "row"):  # lines of rows, not of gaits
                return False
            of_texts = hue in TEXT_COLUMNS or hue in cls.added_columns or names_gait(hue)
            if not of_texts and (numbers is None or hue in numbers):  # a colour scale
                return name in HATCHED and "settle" in cls.runs
        return cls.coloured == "gaits" or (cls.coloured == "periods" and name.startswith("period "))

    @property
    def stem(self) -> str:
        """The name of its file without ending."""
        return self._optional("name") or self.kind_name

    @classmethod
    def suits(cls, run: type[RunKind]) -> bool:
        """Whether it can be drawn from the table of a run of this kind."""
        return kind_of(run) in cls.runs or kind_of(cls) in run.figures

    @classmethod
    def needs_are_met(cls, table: PlannedTable) -> bool:
        """Whether a table has the columns that every figure of this kind needs, whatever its fields."""
        required = {name: None for name, field in cls.model_fields.items() if field.is_required()}
        refusals = cls.model_construct(**required).check(table)
        return all(path != ("kind",) for path, _ in refusals)

    def columns(self) -> dict[str, str]:
        """The columns that it names, by field."""
        return {dotted(path): name for path, name in self._named(self.column_fields).items()}

    def observed(self) -> dict[Path, str]:
        """The observables that it names, by their paths in the figure's fields."""
        return self._named(self.observable_fields)

    def _named(self, fields: Sequence[str]) -> dict[Path, str]:
        """The names in some fields, one or a list each, by their paths; without columns that it adds."""
        names = dict(path_and_name for field in fields for path_and_name in self._items(field))
        return {path: name for path, name in names.items() if name not in (None, *self.added_columns)}

    def _optional(self, field: str) -> Any:
        """The value of a field that not all kinds have; None without it."""
        return dict(self).get(field)

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        """Errors of this kind of figure for the table, besides those checked for all kinds."""
        yield from ()

    def refusals(self, table: PlannedTable) -> Iterator[Refusal]:
        """Errors of the figure for a table that has its columns and observables."""
        yield from self._untypeset()
        if idle := self.idle_colours(self.colours, dict(self)):
            yield ("colours",), f"{idle} Remove it."
        hue = self._optional("hue")
        if hue not in TEXT_COLUMNS - _OUTCOME_COLUMNS:
            yield from StyleNames.of_model(table.model, table.columns).unknown(self, hue)
        yield from self._axis_refusals(dict(self), table.columns, TEXT_COLUMNS)
        yield from self.check(table)

    def needs(self, table: PlannedTable, what: str) -> Refusal:
        """The refusal of a table that lacks columns."""
        run = f"a run of kind {table.run.kind_name} of {table.model.name}"
        return ("kind",), f"is {self.kind_name}, which needs {what}: {run} has no such column."

    @classmethod
    def _axis_refusals(
        cls, fields: Mapping[str, Any], columns: Iterable[str], texts: Collection[str]
    ) -> Iterator[Refusal]:
        """Errors of the columns along axes: one that is not numeric, or is along another axis, too.

        Args:
            fields: the figure's fields.
            columns: the columns of its table.
            texts: those that are not numeric.
        """
        field_of: dict[str, str] = {}
        for field in cls.axis_fields:
            column = fields.get(field)
            if column in texts:
                allowed = near_miss.allowing(name for name in columns if name not in texts)
                yield (field,), f"is {column}, which is not numeric and cannot be an axis. {allowed}"
            elif column in field_of:
                yield (field,), f"is {column}, like {field_of[column]}: name another column."
            elif column is not None:
                field_of[column] = field

    def _untypeset(self) -> Iterator[Refusal]:
        """Errors of texts that Matplotlib cannot typeset between dollar signs."""
        for path, text in self._texts():
            if not can_be_set(text):
                begin = f"is {quoted(text)}, whose formula Matplotlib cannot typeset"
                yield path, f"{begin}: write TeX between two dollar signs, and \\$ for a dollar sign."

    def _texts(self) -> Iterator[tuple[Path, str]]:
        """The texts that the figure shows, with their paths: single ones, and those of lists and mappings."""
        for field in _TYPESET_FIELDS:
            yield from ((path, str(text)) for path, text in self._items(field) if text is not None)

    def _items(self, field: str) -> Iterator[tuple[Path, Any]]:
        """The value of a field, the items of a list, or the keys of a mapping, with their paths."""
        value = self._optional(field)
        if isinstance(value, Mapping):
            yield from (((field, str(key)), key) for key in value)
        elif isinstance(value, Sequence) and not isinstance(value, str):
            yield from (((field, number), item) for number, item in enumerate(value))
        else:
            yield (field,), value

    def __reduce__(self) -> tuple[Callable[..., FigureKind], tuple[str, dict[str, Any]]]:
        return _unpickled, (self.kind_name, dict(self))  # the class of a function has no name in its module


def _unpickled(kind: str, fields: dict[str, Any]) -> FigureKind:
    """A figure of a kind from its fields, which were validated before."""
    return FIGURES[kind].model_construct(**fields)


def check_window(figure: Any) -> Iterator[Refusal]:
    """Errors of a figure's window."""
    if figure.window is not None and not figure.window[0] < figure.window[1]:
        yield ("window",), f"is {quoted(figure.window)}, but its beginning must be before its end."


def check_parameter(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Errors of a figure whose x is a parameter that does not vary between rows."""
    if figure.x not in table.varied and figure.x not in TEXT_COLUMNS:
        yield ("x",), f"is {figure.x}, which does not vary between rows. {near_miss.allowing(table.varied)}"


def check_one_system(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse a job whose rows differ in a parameter that its figure does not show."""
    parameters = [quantity.name for quantity in table.model.parameters]
    shown = {dict(figure).get(field) for field in ("x", "panels", "hue")}
    differing = [name for group in table.rows.groups if group.length > 1 for name in group.axes]
    hidden = [name for name in differing if is_compared(name, parameters) and name not in shown]
    if hidden:
        field = "panels" if "panels" in type(figure).model_fields else "x"
        differ = " and ".join(hidden)
        text = f"leaves out {differ}, in which the rows differ, too: fix its value under params, or draw "
        yield (field,), f"{text}the figure in Python from the rows of one value."


def check_one_parameter(figure: Any, table: PlannedTable) -> Iterator[Refusal]:
    """Refuse an x that is no varying parameter, and rows that differ in another one."""
    wrong = list(check_parameter(figure, table))
    yield from wrong or check_one_system(figure, table)


FIGURES: Registry[FigureKind] = Registry("figure", module="gaitsweep.plot.kinds")
unregister = FIGURES.unregister
Spec = ParamSpec("Spec")


def kinds_with_gait_colours() -> str:
    """The kinds of figures in which gaits have colours, as a sentence."""
    kinds = [name for name in FIGURES if FIGURES[name].coloured == "gaits"]
    return f"Kinds that colour gaits: {', '.join(kinds)}."


def register(kind: type[FigureKind]) -> type[FigureKind]:
    """Add a kind of figure, whose figures obey styles and carry remarks; usable as a decorator.

    Raises:
        TypeError: the class has no field `kind: Literal["its_name"]`.
        ValueError: there is another kind of this name, or `gaitsweep.plot` has the name for something else.
    """
    from gaitsweep import plot

    name = kind_of(kind)
    if name in {*plot.__all__, *(module.name for module in pkgutil.iter_modules(plot.__path__))}:
        raise ValueError(f"gaitsweep.plot.{name} is no figure: choose another name for this kind.")
    return FIGURES.register(kind)


@functools.cache
def drawing_function(kind: type[FigureKind]) -> Callable[..., Figure]:
    """The drawing function of a kind that takes the fields of a style, and `ax`, besides its own arguments.

    Its figures obey styles and carry remarks on their table; errors of an analysis become PlotErrors. Type
    checkers see its own arguments, so that they find one that is missing; `plot.draw` and `plot.style` take a
    style in code that they check.
    """
    takes_table = next(iter(inspect.signature(kind.draw).parameters), "") == "table"

    @functools.wraps(kind.draw)
    def drawn(*args: Any, ax: Axes | None = None, **spec: Any) -> Figure:
        style_fields = {name: spec.pop(name) for name in STYLE_FIELDS if name in spec}
        args = tuple(map(_readable, args))
        spec = {name: _readable(value) for name, value in spec.items()}
        table = args[0] if args else spec.get("table")
        if takes_table and not isinstance(table, pd.DataFrame):
            raise PlotError(_no_table(table))
        _require_names(kind, spec)
        if spec.get("title") == "none":  # as in a job
            spec["title"] = ""
        own, shared = read_style(**style_fields), current()
        numbers = None
        if isinstance(table, pd.DataFrame):
            numbers = [str(name) for name, dtype in table.dtypes.items() if is_numeric_dtype(dtype)]
            with _blaming_lost_units(table):
                _check_names(table, own, shared, spec.get("hue"))
                _check_axes(kind, table, spec)
        if idle := kind.idle_colours(own.colours, spec, numbers):
            raise PlotError(f"colours {idle}")
        if shared.colours and not any(kind.colours_of(name, spec, numbers) for name in shared.colours):
            idle = kind.idle_colours(shared.colours, spec, numbers)
            warn(f"colours of plot.style {idle}")
        with styled(own, ax), _blaming_lost_units(table):
            try:
                figure = kind.draw(*args, **spec)
            except AnalysisError as error:
                raise PlotError(str(error)) from error
            panel = given_axes()
            figure = figure if panel is None else cast("Figure", panel.get_figure(root=True))
            letters = current().panel_letters
            if letters and (panel is None or isinstance(letters, list)):
                letter_panels(figure.axes if panel is None else [panel], letters)
            if isinstance(table, pd.DataFrame) and current().marks is not False:
                mark(figure if panel is None else panel, remarks(table))
        return figure

    return drawn


def _readable(value: Any) -> Any:
    """A table with an index from 0, by which figures find its rows, and without `pd.NA`; else the argument.

    `pandas.concat` repeats index values, and a selection of rows leaves some out. NaN takes the place of
    `pd.NA`, which NumPy cannot compare.
    """
    if not isinstance(value, pd.DataFrame):
        return value
    if not value.index.equals(pd.RangeIndex(len(value))):
        value = value.reset_index(drop=True)
    with_na = [place for place in range(value.shape[1]) if _may_have_na(value.iloc[:, place])]
    value = value.copy(deep=False) if with_na else value
    for place in with_na:
        values = value.iloc[:, place].astype(object)
        value.isetitem(place, values.where(values.notna(), np.nan).infer_objects())
    return value


def _may_have_na(column: pd.Series) -> bool:
    """Whether missing values of a column are `pd.NA`, of a column of objects whether it has one."""
    if pd.api.types.is_object_dtype(column):
        return any(item is pd.NA for item in column)
    return getattr(column.dtype, "na_value", None) is pd.NA


def _no_table(value: object) -> str:
    """The sentence about an argument that is no table."""
    kind = type(value).__name__
    hint = f": load it by gs.load({value!r})." if isinstance(value, str) else "."
    if kind == "Result":
        hint = ": give its .table, or write result.plot.KIND(...)."
    return f"table is a {kind}, but must be a table{hint}"


@contextlib.contextmanager
def _blaming_lost_units(table: object) -> Iterator[None]:
    """A context whose refusals say so if a table has lost its units and job, which may be the cause."""
    lost = isinstance(table, pd.DataFrame) and not {"quantities", "job"} & set(table.attrs)
    try:
        yield
    except PlotError as error:
        of_table = any(word in str(error) for word in ("column", "gait", "job"))  # not of a height
        if not lost or not of_table or str(error).endswith(_LOST):
            raise
        raise type(error)(f"{error}{'' if str(error).endswith('.') else '.'} {_LOST}") from None


def _require_names(kind: type[FigureKind], fields: Mapping[str, Any]) -> None:
    """Refuse arguments that are no names of columns.

    Raises:
        PlotError: with the argument.
    """
    for field in fields.keys() & {*kind.axis_fields, "hue", "panels"} & kind.model_fields.keys():
        value = fields[field]
        if not isinstance(value, str) and (value is not None or kind.model_fields[field].is_required()):
            raise PlotError(f"{field} is {value!r}, but must be the name of a column.")


def _check_axes(kind: type[FigureKind], table: pd.DataFrame, fields: Mapping[str, Any]) -> None:
    """Refuse columns along axes as in a job, and observables whose column has texts.

    Raises:
        PlotError: a column is not numeric, or is named twice.
    """
    texts = [str(name) for name, dtype in table.dtypes.items() if not is_numeric_dtype(dtype)]
    wrong = [*kind._axis_refusals(fields, map(str, table), texts)]
    for field in kind.observable_fields:
        if fields.get(field) in texts:
            wrong.append(((field,), f"is {fields[field]}, which is not numeric and cannot be an axis."))
    _refuse(wrong)


def _check_names(table: pd.DataFrame, own: FigureStyle, shared: FigureStyle, hue: str | None) -> None:
    """Refuse names of gaits and columns in a style that name nothing in the table or in its model.

    Raises:
        PlotError: a name names nothing; the message has the near miss.
    """
    styles = (own, shared)
    if all(style.colours is None and style.order is None and style.labels is None for style in styles):
        return
    from gaitsweep.plot.limbs import model_of  # jobs are read without Matplotlib

    names = StyleNames.of_table(table, model_of(table))
    _refuse([*names.unknown(own, hue), *names.unknown(shared, hue, shared=True)])


def _refuse(wrong: Sequence[Refusal]) -> None:
    """Raise PlotError with all errors, if there are any."""
    if wrong:
        raise PlotError("\n".join(str(Diagnostic(path, text)) for path, text in wrong))


def figure_kind(
    *runs: str,
    check: Callable[[Any, PlannedTable], Iterator[Refusal]] | None = None,
    added_columns: tuple[str, ...] = (),
    coloured: Coloured = "gaits",
    gaits_by_default: bool = False,
) -> Callable[[Callable[Spec, Figure]], Callable[Spec, Figure]]:
    """Register a function from a table to a figure as a kind; its figures carry remarks. A decorator.

    Arguments of the function with an annotated description are fields of the kind in a job, besides `name`.

    Args:
        runs: the run kinds whose tables it can show.
        check: like `FigureKind.check`, for the figure in a job and the planned table.
        added_columns: columns that it adds to the table.
        coloured: the names whose colours in a style have an effect: of gaits, of periods, or of none.
        gaits_by_default: whether it colours gaits where its argument `hue` is left out.
    """

    def registered(draw: Callable[Spec, Figure]) -> Callable[Spec, Figure]:
        name = draw.__name__
        about = (inspect.getdoc(draw) or "").partition("\n\n")[0]
        fields: dict[str, Any] = {
            "kind": (Literal[name], Field(description=f"{name}: {about}")),
            **fields_of(draw),
            "name": (Name, Field(None)),
        }
        # the members of a class that has them in its body
        members: dict[str, Any] = {
            "draw": staticmethod(draw),
            "runs": runs,
            "added_columns": added_columns,
            "coloured": coloured,
            "gaits_by_default": gaits_by_default,
        }
        for role in Role:
            members[role.value] = tuple(
                field for field, (type_, _) in fields.items() if role in parts_of([type_])
            )
        if check is not None:
            members["check"] = check
        fields |= {member: (ClassVar[Any], value) for member, value in members.items()}
        title = name.title().replace("_", "")
        kind = create_model(title, __base__=FigureKind, __doc__=about, __module__=draw.__module__, **fields)
        return cast("Callable[Spec, Figure]", drawing_function(register(kind)))

    return registered
