"""What a figure cannot show of a job's table, as far as the job alone tells it: said before any row runs.

The counterpart of what the functions in `plot` refuse of a table. What only the table's numbers tell (a gait
whose ranges lie apart, say) is refused there.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from gaitsweep import near_miss
from gaitsweep.contract import Model
from gaitsweep.job import figure_kinds as kinds
from gaitsweep.job.axes import Spread, Steps
from gaitsweep.job.branch_figures import StableRanges
from gaitsweep.job.figure_part import FigurePart
from gaitsweep.job.gait_figures import GaitRamp, GaitSeries, LoadingRule, NineGaits, SpeedGaits
from gaitsweep.job.multilegged_figures import DriftLaw, GaitShares
from gaitsweep.job.plan import Plan
from gaitsweep.kinds.complaints import Path, found
from gaitsweep.kinds.runs import Run, Settle, Trace

Refusal = tuple[Path, str]  # where in the figure, and the end of the sentence

TEXT_COLUMNS = frozenset({"status", "gait", "special", "end", "slowest", "stalled_by"})
MEASURES = ("load_together", "load_late", "load_stance", "tilt_together", "tilt_late", "tilt_stance")
_LEGS = ("LF", "RF", "LH", "RH")
_ENDS = {"m": ("m_1", "m_end"), "kappa": ("kappa_1", "kappa_end"), "a": ("a_1", "a_end")}
_ON_AXES: dict[type[FigurePart], tuple[str, ...]] = {  # columns that are drawn along an axis
    kinds.Basin: ("x", "y"),
    kinds.GaitMap: ("x", "y"),
    kinds.Shock: ("x", "y"),
    kinds.Cycles: ("x",),
    kinds.Branches: ("x",),
    GaitShares: ("x", "y"),
    StableRanges: ("y",),
}
_FEW = 200_000  # points of an axis that are looked at


@dataclasses.dataclass(frozen=True)
class Given:
    """What is known of a table before it is there: the job's rows, its run, and its columns."""

    plan: Plan
    run: Run
    columns: Sequence[str]

    @property
    def model(self) -> Model:
        return self.plan.model

    @property
    def varied(self) -> tuple[str, ...]:
        return self.plan.names

    def lacks(self, names: Sequence[str]) -> str | None:
        """The first of the names that is no column."""
        return next((name for name in names if name not in self.columns), None)

    def unit(self, column: str) -> str:
        """A column's unit, as the manifest's `quantities` will have it."""
        model = self.model
        units = {f"{q.name}_{end}": q.unit for q in model.observables for end in ("end", "n")}
        for each in (
            model.parameters,
            model.observables,
            model.signals,
            model.label_fields,
            model.initial_conditions,
        ):
            units |= {q.name: q.unit for q in each}
        return units.get(column, "")


def refusals(figure: FigurePart, given: Given) -> Iterator[Refusal]:
    """Why a figure cannot be drawn of the table that a job makes, one by one.

    Args:
        figure: the figure, whose columns and observables are known to be there.
        given: the table, as far as it is known.
    """
    yield from _titles(figure)
    along = [(field, getattr(figure, field)) for field in _ON_AXES.get(type(figure), ())]
    for number, (field, column) in enumerate(along):
        if column in TEXT_COLUMNS:
            numbers = [name for name in given.columns if name not in TEXT_COLUMNS]
            yield (field,), f"is {column}, which has no numbers for an axis. {near_miss.allowing(numbers)}"
        elif column is not None and column in [other for _, other in along[:number]]:
            yield (field,), f"is {column}, as {along[0][0]} is: name another column."
    for kind, check in _CHECKS.items():
        if type(figure) is kind:
            yield from check(figure, given)


def _titles(figure: FigurePart) -> Iterator[Refusal]:
    """What Matplotlib cannot set between dollar signs."""
    texts: list[tuple[Path, str]] = []
    for field in ("title", "titles", "points", "intervals"):
        written = getattr(figure, field, None)
        if isinstance(written, str):
            texts.append(((field,), written))
        elif written:
            texts += [((field, at if isinstance(written, list) else str(each)), str(each))
                      for at, each in enumerate(written)]  # fmt: skip
    for path, text in texts:
        if text.replace("\\$", "").count("$") < 2:
            continue
        from matplotlib.mathtext import MathTextParser  # only for a job that has formulas in its titles

        try:
            MathTextParser("path").parse(text)
        except (ValueError, RuntimeError, RecursionError):
            told = f"is {found(text)}, whose formula Matplotlib cannot set"
            yield path, f"{told}: write TeX between two dollar signs, and \\$ for a dollar."


def _basin(figure: kinds.Basin | kinds.Shock, given: Given) -> Iterator[Refusal]:
    if figure.x == figure.y or not {figure.x, figure.y} <= set(given.varied):
        return  # cells that only the table has
    if figure.panels not in (None, *given.varied):
        return
    shown = {figure.x, figure.y, figure.panels}
    others = [g for g in given.plan.groups if g.length > 1 and not shown & set(g.points)]
    if others and _grid(given.plan, figure.x) and _grid(given.plan, figure.y):
        name = next(iter(others[0].points))
        near = f"name it as panels, or fix its value under {_field(given, name)}"
        yield (
            ("panels",),
            f"leaves {name} out, which varies too: a cell of {figure.x} and {figure.y} would have "
            f"several rows; {near}.",
        )


def _field(given: Given, name: str) -> str:
    return "params" if name in [q.name for q in given.model.parameters] else "start"


def _grid(plan: Plan, name: str) -> bool:
    """Whether a name's points are sure to be drawn as cells: equal steps, or few points that stand alone."""
    for group in plan.groups:
        points = group.points.get(name)
        if points is None:
            continue
        if points.formulas or points.length > _FEW:
            return False
        if isinstance(points, Spread) and isinstance(points.fraction, Steps) and not points.logarithmic:
            return True
        return np.unique(points.at(np.arange(points.length), {})).size <= 4
    return False


def _shock(figure: kinds.Shock, given: Given) -> Iterator[Refusal]:
    units = {column: given.unit(column) for column in (figure.x, figure.y)}
    if not TEXT_COLUMNS & set(units) and len(set(units.values())) > 1:
        shown = " and ".join(f"{column} in {unit or '1'}" for column, unit in units.items())
        yield ("y",), f"is {figure.y}, but a shock is a distance, which needs one unit: {shown}."
    else:
        yield from _basin(figure, given)


def _basin_measures(figure: kinds.BasinMeasures, given: Given) -> Iterator[Refusal]:
    if figure.panels == "attractor":
        yield ("panels",), "is attractor, which is worked out, and no column of this job's table."
    axes = figure.axes
    if axes is None:
        axes = [name for name in given.varied if name != figure.panels]
        if not axes:
            yield ("axes",), "is missing: besides panels nothing varies that could be the starts."
    for at, name in enumerate(axes):
        if name in TEXT_COLUMNS:
            yield ("axes", at), f"is {name}, which has no numbers: take what varies."
        elif name in axes[:at] or name == figure.panels:
            yield ("axes", at), f"is {name}, which is named twice."
    units = {name: given.unit(name) for name in axes if name not in TEXT_COLUMNS}
    if len(set(units.values())) > 1:
        shown = ", ".join(f"{name} in {unit or '1'}" for name, unit in units.items())
        yield ("axes",), f"needs one unit for the distance between starts, but there are {shown}."
    if figure.hue == "attractor" and isinstance(given.run, Settle) and given.run.refine is not None:
        yield ("hue",), "is attractor, but run.refine infers rows, which have no state to tell one by."


def _branches(figure: kinds.Branches, given: Given) -> Iterator[Refusal]:
    if figure.x not in given.varied and figure.x not in TEXT_COLUMNS:
        yield ("x",), f"is {figure.x}, which does not vary between rows. {near_miss.allowing(given.varied)}"


def _footprints(figure: kinds.Footprints, given: Given) -> Iterator[Refusal]:
    if "contact_1" not in given.columns:
        yield ("kind",), _needs(figure.kind, given, "the signals contact_1, contact_2, ...")


def _drift_law(figure: DriftLaw, given: Given) -> Iterator[Refusal]:
    pairs = list(_ENDS.values()) if figure.of == "ends" else [_ENDS[figure.of]]
    if not any(given.lacks(pair) is None for pair in pairs):
        told = ", or ".join(" and ".join(pair) for pair in pairs)
        yield ("of",), f"is {figure.of}, for which {told} have to vary in this job."
    elif given.lacks(["psi_1_end"]):
        yield ("kind",), _needs(figure.kind, given, "the multi-legged chain's psi_1")


def _gait_shares(figure: GaitShares, given: Given) -> Iterator[Refusal]:
    if given.lacks(["psi_1_end"]):
        yield ("kind",), _needs(figure.kind, given, "the multi-legged chain's psi_1")
        return
    sets = [name for name in given.varied if not name.startswith(("psi_", "phi_"))]
    for field in ("x", "y"):
        column = getattr(figure, field)
        if column is not None and column not in sets and column not in TEXT_COLUMNS:
            allowed = near_miss.allowing(sets)
            yield (field,), f"is {column}, which is no parameter that varies in this job. {allowed}"


def _tells_gaits(given: Given) -> bool:
    """Whether a table says when legs begin to swing, as `analysis.gait_tables` reads it."""
    averages = ("delta_1_mean", "delta_2_mean", "period", "variation", "antiphase", "length")
    return (
        given.lacks([f"{name}_end" for name in averages]) is None
        or given.lacks([f"since_{leg}_n" for leg in _LEGS]) is None
        or given.lacks([f"u_f_{leg}" for leg in _LEGS]) is None
    )


def _nine(figure: FigurePart, given: Given) -> Iterator[Refusal]:
    if not _tells_gaits(given):
        what = "when each of four legs begins to swing (planar_quadruped tells it)"
        yield ("kind",), _needs(str(getattr(figure, "kind", "")), given, what)


def _speed_gaits(figure: SpeedGaits, given: Given) -> Iterator[Refusal]:
    yield from _nine(figure, given)
    if figure.y != "gait" and figure.y in TEXT_COLUMNS:
        yield ("y",), f"is {figure.y}, which has no numbers: take gait, or what varies."


def _gait_series(figure: GaitSeries, given: Given) -> Iterator[Refusal]:
    needed = ["pitch", *(f"u_f_{leg}" for leg in _LEGS), *_contacts()]
    needed += [f"F_{leg}" for leg in _LEGS if figure.loads]
    if (name := given.lacks(needed)) is not None:
        yield ("kind",), _needs(figure.kind, given, f"the signal {name}")
    if figure.row is not None and figure.row >= given.plan.n_rows:
        yield ("row",), f"is {figure.row}, but the job has rows 0 to {given.plan.n_rows - 1}."
    if figure.window is not None and not figure.window[0] < figure.window[1]:
        yield ("window",), f"is {found(figure.window)}, but its begin comes before its end."
    if figure.strip is not None and isinstance(given.run, Trace):
        strips = given.run.duration / figure.strip
        if strips > 10_000 or math.isinf(strips):
            text = f"is {figure.strip:g} s, which makes {strips:.3g} strips of {given.run.duration:g} s."
            yield ("strip",), text


def _nine_gaits(figure: NineGaits, given: Given) -> Iterator[Refusal]:
    needed = [*(f"u_f_{leg}" for leg in _LEGS), *_contacts()]
    if (name := given.lacks(needed)) is not None:
        yield ("kind",), _needs(figure.kind, given, f"the signal {name}")


def _loading_rule(figure: LoadingRule, given: Given) -> Iterator[Refusal]:
    if not _tells_gaits(given):
        yield from _nine(figure, given)
        return
    settled = given.lacks(["late_load_LF_end"]) is None
    traced = ["pitch", *(f"u_f_{leg}" for leg in _LEGS), *(f"F_{leg}" for leg in _LEGS)]
    if not settled and (name := given.lacks(traced)) is not None:
        yield ("kind",), _needs(figure.kind, given, f"the signal {name}, or loads where rows end")
    told = [name for name in MEASURES if not settled or not name.endswith("together")]
    for at, name in enumerate(figure.measures or []):
        if name not in told:
            text = f"is {name}, which this job's table does not tell{near_miss.suggestion(name, told)}"
            yield ("measures", at), text
    if (figure.only is None) != (figure.value is None):
        field, other = ("only", "value") if figure.only is None else ("value", "only")
        yield (field,), f"is missing, but {other} is given: they go together."
    elif figure.only in TEXT_COLUMNS:
        yield ("only",), f"is {figure.only}, which has no numbers: take what varies."


def _contacts() -> list[str]:
    return [f"contact_{number}" for number in range(1, len(_LEGS) + 1)]


def _needs(kind: str, given: Given, what: str) -> str:
    return (
        f"is {kind}, which needs {what}: a run of {given.run.kind} of {given.model.name} has no such column."
    )


_CHECKS: dict = {
    kinds.Basin: _basin,
    kinds.Shock: _shock,
    kinds.BasinMeasures: _basin_measures,
    kinds.Branches: _branches,
    kinds.Footprints: _footprints,
    DriftLaw: _drift_law,
    GaitShares: _gait_shares,
    SpeedGaits: _speed_gaits,
    GaitSeries: _gait_series,
    GaitRamp: _nine,
    NineGaits: _nine_gaits,
    LoadingRule: _loading_rule,
}
