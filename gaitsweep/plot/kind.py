"""The interface of a kind of figure: its fields, its runs and columns, and its drawing.

`figure_kind` turns a drawing function into a kind; its fields in a job are the function's arguments.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    ParamSpec,
    cast,
)

import pandas as pd
from pydantic import Field, create_model

from gaitsweep import near_miss
from gaitsweep.kinds.run_kind import RunKind
from gaitsweep.mathtext import can_be_set
from gaitsweep.plot.arguments import TEXT_COLUMNS, Name
from gaitsweep.plot.columns import PlotError
from gaitsweep.plot.figure_style import STYLE_FIELDS, FigureStyle, current, given_axes, read_style, styled
from gaitsweep.plot.function_fields import fields_of, parts_of
from gaitsweep.plot.planned_table import PlannedTable, Refusal
from gaitsweep.plot.provenance_marks import letter_panels, mark, remarks
from gaitsweep.plot.style_names import StyleNames
from gaitsweep.schema.diagnostics import Diagnostic, Path, quoted
from gaitsweep.schema.strict_model import Registry, kind_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Coloured = Literal["gaits", "periods", "none"]


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
    worked_out: ClassVar[tuple[str, ...]] = ()  # columns that it adds to the table
    coloured: ClassVar[Coloured] = "gaits"  # the names whose colours have an effect

    @property
    def kind_name(self) -> str:
        """The value of the field `kind`."""
        return kind_of(type(self))

    @classmethod
    def idle_colours(cls, colours: Mapping[str, str] | None) -> str | None:
        """The end of a sentence about colours of which none or some have no effect; None: all have one."""
        stray = [name for name in colours or {} if not cls.colours_of(name)]
        if not stray:
            return None
        if cls.coloured == "periods":
            kind = kind_of(cls)
            return f"has no effect for {', '.join(stray)}: a figure {kind} colours periods (period 1: red)."
        return f"has no effect: a figure {kind_of(cls)} does not colour gaits."

    @classmethod
    def colours_of(cls, name: str) -> bool:
        """Whether the colour of a gait, or of a period of an atlas, has an effect."""
        return cls.coloured == "gaits" or (cls.coloured == "periods" and name.startswith("period "))

    @property
    def stem(self) -> str:
        """The name of its file without ending."""
        return getattr(self, "name", None) or self.kind_name

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
        return {
            "".join([str(field), *(f"[{number}]" for number in rest)]): name
            for (field, *rest), name in self._named(self.column_fields).items()
        }

    def observed(self) -> dict[Path, str]:
        """The observables that it names, by their paths in the figure's fields."""
        return self._named(self.observable_fields)

    def _named(self, fields: Sequence[str]) -> dict[Path, str]:
        places: dict[Path, Any] = {}
        for field in fields:
            value = getattr(self, field)
            several = isinstance(value, list)
            places |= {(field, n): name for n, name in enumerate(value)} if several else {(field,): value}
        return {place: name for place, name in places.items() if name not in (None, *self.worked_out)}

    def check(self, table: PlannedTable) -> Iterator[Refusal]:
        """Errors of this kind of figure for the table, besides those checked for all kinds."""
        yield from ()

    def refusals(self, table: PlannedTable) -> Iterator[Refusal]:
        """Errors of the figure for a table that has its columns and observables."""
        yield from self._titles()
        if idle := self.idle_colours(self.colours):
            yield ("colours",), f"{idle} Remove it."
        if getattr(self, "hue", None) not in TEXT_COLUMNS - {"gait", "outcome", "status"}:
            yield from StyleNames.of_model(table.model, table.columns).unknown(self)
        along = [(field, getattr(self, field)) for field in self.axis_fields]
        for number, (field, column) in enumerate(along):
            if column in TEXT_COLUMNS:
                numbers = [name for name in table.columns if name not in TEXT_COLUMNS]
                yield (
                    (field,),
                    f"is {column}, which is not numeric and cannot be an axis. {near_miss.allowing(numbers)}",
                )
            elif column is not None and column in [other for _, other in along[:number]]:
                yield (field,), f"is {column}, like {along[0][0]}: name another column."
        yield from self.check(table)

    def needs(self, table: PlannedTable, what: str) -> Refusal:
        """The refusal of a table that lacks columns."""
        text = (
            f"is {self.kind_name}, which needs {what}: a run of kind {table.run.kind_name} of "
            f"{table.model.name}"
        )
        return ("kind",), f"{text} has no such column."

    def _titles(self) -> Iterator[Refusal]:
        """Errors in texts that Matplotlib cannot typeset between dollar signs."""
        texts: list[tuple[Path, str]] = []
        for field in ("title", "titles", "points", "intervals", "ticks"):
            written: Any = getattr(self, field, None)
            if isinstance(written, str):
                texts.append(((field,), written))
            elif written:
                texts += [((field, at if isinstance(written, list) else str(text)), str(text))
                          for at, text in enumerate(written)]  # fmt: skip
        for path, text in texts:
            if not can_be_set(text):
                begin = f"is {quoted(text)}, whose formula Matplotlib cannot typeset"
                yield path, f"{begin}: write TeX between two dollar signs, and \\$ for a dollar sign."

    def __reduce__(self) -> tuple[Callable[..., FigureKind], tuple[str, dict[str, Any]]]:
        return _unpickled, (self.kind_name, dict(self))  # the class of a function has no name in its module


def check_window(figure: Any) -> Iterator[Refusal]:
    """Errors of a figure's window."""
    if figure.window is not None and not figure.window[0] < figure.window[1]:
        yield ("window",), f"is {quoted(figure.window)}, but its beginning must be before its end."


FIGURES: Registry[FigureKind] = Registry("figure", module="gaitsweep.plot.kinds")
unregister = FIGURES.unregister
Spec = ParamSpec("Spec")


def register(kind: type[FigureKind]) -> type[FigureKind]:
    """Add a kind of figure, whose figures obey styles and carry remarks; usable as a decorator.

    Raises:
        TypeError: the class has no field `kind: Literal["its_name"]`.
        ValueError: there is another kind of this name.
    """
    FIGURES.register(kind)
    kind.draw = staticmethod(_in_style(kind.draw, kind))
    return kind


def _in_style(draw: Callable[Spec, Figure], kind: type[FigureKind]) -> Callable[Spec, Figure]:
    """A drawing function that takes the fields of a style, and `ax`, besides its own arguments.

    Type checkers see its own arguments, so that they find one that is missing; `plot.draw` and `plot.style`
    take a style in code that they check.
    """

    @functools.wraps(draw)
    def drawn(*args: Any, ax: Axes | None = None, **spec: Any) -> Figure:
        style_fields = {name: spec.pop(name) for name in STYLE_FIELDS if name in spec}
        table = args[0] if args else spec.get("table")
        if spec.get("title") == "none":  # as in a job
            spec["title"] = ""
        own, shared = read_style(**style_fields), current()
        if isinstance(table, pd.DataFrame):
            _check_names(table, own, shared)
        if idle := kind.idle_colours(own.colours):
            raise PlotError(f"colours {idle}")
        with styled(own, ax):
            figure = draw(*args, **spec)  # pyright: ignore[reportCallIssue]
            panel = given_axes()
            figure = figure if panel is None else cast("Figure", panel.get_figure(root=True))
            letters = current().panel_letters
            if letters and (panel is None or isinstance(letters, list)):
                letter_panels(figure.axes if panel is None else [panel], letters)
            if isinstance(table, pd.DataFrame) and current().marks is not False:
                mark(figure if panel is None else panel, remarks(table))
        return figure

    return drawn  # pyright: ignore[reportReturnType] - a ParamSpec cannot have more keywords


def _check_names(table: pd.DataFrame, own: FigureStyle, shared: FigureStyle) -> None:
    """Refuse names of gaits and columns in a style that name nothing in the table or in its model.

    Raises:
        PlotError: a name names nothing; the message has the near miss.
    """
    if not any((each.colours, each.order, each.labels) != (None, None, None) for each in (own, shared)):
        return
    from gaitsweep.plot.limbs import model_of  # jobs are read without Matplotlib

    names = StyleNames.of_table(table, model_of(table))
    wrong = [*names.unknown(own), *names.unknown(shared, shared=True)]
    if wrong:
        raise PlotError("\n".join(str(Diagnostic(path, text)) for path, text in wrong))


def figure_kind(
    *runs: str,
    check: Callable[[Any, PlannedTable], Iterator[Refusal]] | None = None,
    worked_out: tuple[str, ...] = (),
    coloured: Coloured = "gaits",
) -> Callable[[Callable[Spec, Figure]], Callable[Spec, Figure]]:
    """Register a function from a table to a figure as a kind; its figures carry remarks. A decorator.

    Arguments of the function with an annotated description are fields of the kind in a job, besides `name`.

    Args:
        runs: the run kinds whose tables it can show.
        check: like `FigureKind.check`, for the figure in a job and the planned table.
        worked_out: columns that it adds to the table.
        coloured: the names whose colours in a style have an effect: of gaits, of periods, or of none.
    """

    def registered(draw: Callable[Spec, Figure]) -> Callable[Spec, Figure]:
        name, about = draw.__name__, (inspect.getdoc(draw) or "").partition("\n\n")[0]
        fields: dict[str, Any] = {
            "kind": (Literal[name], Field(description=f"{name}: {about}")),
            **fields_of(draw),
            "name": (Name, Field(None)),
        }
        title = name.title().replace("_", "")
        kind = create_model(title, __base__=FigureKind, __doc__=about, __module__=draw.__module__, **fields)
        kind.draw, kind.runs, kind.worked_out = staticmethod(draw), runs, worked_out
        kind.coloured = coloured
        for role in ("column_fields", "axis_fields", "observable_fields"):
            setattr(kind, role, tuple(n for n, (type_, _) in fields.items() if role in parts_of([type_])))
        if check is not None:
            kind.check = check  # pyright: ignore[reportAttributeAccessIssue]
        return register(kind).draw

    return registered


def draw(kind: str, table: pd.DataFrame, **spec: Any) -> Figure:
    """Draw a figure of some kind from a table.

    Args:
        kind: a key of FIGURES.
        table: a result table from `gaitsweep.load`.
        spec: the arguments of the kind, the fields of `FigureStyle`, and `ax`, Matplotlib axes for a figure
            of one panel.

    Raises:
        PlotError: the kind is unknown, the table lacks a column of the figure, or the figure has several
            panels and `ax` is given.
        StyleError: a field of the style is not allowed.
    """
    if kind not in FIGURES:
        raise PlotError(f"{kind} is not a kind of figure{near_miss.suggestion(kind, FIGURES)}")
    return FIGURES[kind].draw(table, **spec)


def _unpickled(kind: str, fields: dict[str, Any]) -> FigureKind:
    return FIGURES[kind].model_construct(**fields)
