"""Faults that the declarations of a model's class show before a model is made of it."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Collection, Iterator, Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitsweep.column_meanings import COLUMNS, time_column
from gaitsweep.contract import Quantity
from gaitsweep.dynamics.declarations import Variable
from gaitsweep.dynamics.gaits_by_footfalls import Footfalls
from gaitsweep.dynamics.noise import Diffusion
from gaitsweep.dynamics.sliding import Sliding
from gaitsweep.expression import RESERVED
from gaitsweep.near_miss import suggestion

if TYPE_CHECKING:
    from gaitsweep.dynamics.declared import Declared

# Columns of traces, where signals have columns of their own names.
OF_TRACES = ("row", "t", "pass", "status", "stalled_by", "gait")


def refuse_contradictions(model: type[Declared], added_fields: Collection[str], *, labels: bool) -> None:
    """Refuse declarations that exclude each other, or whose names, counts or values are wrong.

    Args:
        model: the class, which need not be a dataclass yet.
        added_fields: fields of its state that are not declared.
        labels: whether it has a `label` of its own.

    Raises:
        TypeError: with the names of the declarations.
    """
    _refuse_names(model, added_fields)
    _refuse_several(model)
    _refuse_events_without_section(model)
    _refuse_footfalls(model, labels=labels)
    _refuse_sliding(model)
    sizes = _default_sizes(model)
    counts = _named_counts(model)
    for name, count in counts.items():
        if count not in sizes and not hasattr(model, count):
            field = f"a field of its structure{suggestion(count, sizes) if sizes else ': it has none.'}"
            raise TypeError(f'{model.__name__} declares {name} with count="{count}", which is not {field}')
    if all(isinstance(sizes.get(count), int) for count in counts.values()):
        wrong = next(_faults(model, sizes), None)
        if wrong is not None:
            raise TypeError(f"{model.__name__} is a model {wrong}")


def _refuse_names(model: type[Declared], added_fields: Collection[str]) -> None:
    """Refuse declarations with the names of members that every model has."""
    # the base that this package gives; its own declarations are no names of the user's
    base = next(base for base in model.__mro__[1:] if base.__module__.startswith("gaitsweep.dynamics."))
    declared_by_base = getattr(base, "declarations", {})
    for name, declaration in model.declarations.items():
        if declared_by_base.get(name) is declaration:
            continue
        if name in ("replace", *added_fields) or hasattr(base, name):
            raise TypeError(f"{model.__name__} declares {name}, a name that every model has: rename it.")


def _refuse_events_without_section(model: type[Declared]) -> None:
    """Refuse events of which none closes a cycle."""
    events = model.declarations.events
    if events and not any(event.section for event in events):
        remedy = "write section=True for the one that ends a cycle"
        raise TypeError(f"{model.__name__} has events but no section: {remedy}.")


def _refuse_footfalls(model: type[Declared], *, labels: bool) -> None:
    """Refuse footfalls without a clock, or beside gaits of the model's own that nothing assigns."""
    feet = model.declarations.feet
    if feet is None:
        return
    variables = model.declarations.of_kind(Variable)
    if feet.clock not in variables:
        near = suggestion(feet.clock, variables)
        raise TypeError(f"{model.__name__} has footfalls of the clock {feet.clock}, no variable{near}")
    if model.gaits != feet.gaits and not labels:
        remedy = f"leave gaits out, which then are {', '.join(feet.gaits)}, or write label"
        raise TypeError(f"{model.__name__} has footfalls and gaits of its own without label: {remedy}.")


def _refuse_several(model: type[Declared]) -> None:
    """Refuse several declarations of a kind that a model has once."""
    kinds = {"surfaces of sliding": Sliding, "footfalls": Footfalls, "diffusions": Diffusion}
    for noun, kind in kinds.items():
        if len(names := model.declarations.of_kind(kind)) > 1:
            remedy = "only one is allowed; NAME = None removes that of a base"
            raise TypeError(f"{model.__name__} declares the {noun} {' and '.join(names)}: {remedy}.")


def _refuse_sliding(model: type[Declared]) -> None:
    """Refuse a surface of sliding that the flow does not know."""
    for name, surface in model.declarations.of_kind(Sliding).items():
        if getattr(getattr(model, "flow", None), "sliding", None) is not surface:
            raise TypeError(f"{model.__name__} declares {name} as sliding: write @{name}.flow above flow.")


def _named_counts(model: type[Declared]) -> dict[str, str]:
    """The fields of the structure that declarations name as their count, by the declaration."""
    counts = {name: getattr(declared, "count", None) for name, declared in model.declarations.items()}
    return {name: count for name, count in counts.items() if isinstance(count, str)}


def _default_sizes(model: type[Declared]) -> dict[str, Any]:
    """The fields of the structure with their defaults, of a class that is no dataclass yet."""
    hints: dict[str, Any] = {}
    for base in reversed(model.__mro__):
        hints.update(inspect.get_annotations(base))
    sizes: dict[str, Any] = {}
    for name, hint in hints.items():
        if "ClassVar" not in str(hint):
            value = getattr(model, name, None)
            sizes[name] = value.default if isinstance(value, dataclasses.Field) else value
    return sizes


def _faults(model: type[Declared], sizes: Mapping[str, Any]) -> Iterator[str]:
    """Faults of names, units, bounds and defaults that the declarations alone show, as ends of sentences.

    Args:
        model: the class.
        sizes: the fields of the structure by name.
    """
    declarations = model.declarations
    # no model can be made of a class that is not complete, and declarations read only its structure
    structure: Any = SimpleNamespace(**sizes)
    settable = [*declarations.parameters(structure), *(starts := declarations.starts(structure))]
    signals = declarations.signals(structure)
    observables = declarations.observables(structure)
    names = [quantity.name for quantity in settable]
    for name in names:
        if name in RESERVED:
            remedy = f'write {name}_, or another name with symbol="{name}"'
            yield f"with a quantity {name}, which means something else in formulas: {remedy}."
        if names.count(name) > 1:
            yield f"that declares {name} twice: rename one of them."
    # a table has the signals, or the observables with an end, and those alone along a branch
    times = (time_column(single.name) for single in declarations.single_events(structure))
    run_columns = {*COLUMNS, *times}
    columns = {name: (name, run_columns) for name in names}
    columns |= {q.name: (q.name, OF_TRACES) for q in signals}
    columns |= {f"{q.name}{end}": (q.name, run_columns) for q in observables for end in ("", "_end", "_n")}
    for column, (name, others) in columns.items():
        if column in others or (column in names and column != name):
            remedy = f'write {name}_, or another name with symbol="{name}"'
            page = "`gaitsweep examples own_model` copies a page with the names of columns"
            yield f"with a quantity {name}, but tables have a column {column}: {remedy}. {page}."
    for quantity in (*settable, *signals, *observables):
        yield from faults_of_quantity(quantity, quantity in starts)


def faults_of_quantity(quantity: Quantity, start: bool) -> Iterator[str]:
    """Faults of a quantity's unit, meaning, bounds, default and scale, as ends of sentences.

    Args:
        quantity: with its name.
        start: whether it is an initial condition, whose default may be NaN: then the model decides it.
    """
    name = quantity.name
    low = quantity.low
    high = quantity.high
    for field in ("unit", "meaning"):
        if not getattr(quantity, field):
            unit = ' ("1" for a number without one)' if field == "unit" else ""
            yield f"whose {name} has no {field}, which tables and figures show{unit}."
    if quantity.circular and quantity.unit not in ("rad", ""):
        yield f"whose {name} is circular in {quantity.unit}, but only angles in rad can be circular."
    if not low <= high or (low == high and quantity.open_ends):
        yield f"whose {name} has bounds that allow no value: low is {low:g}, high is {high:g}."
    elif isinstance(quantity.default, int | float | np.integer | np.floating):
        undecided = start and math.isnan(quantity.default)  # a start that the model itself decides
        inside = low < quantity.default < high if quantity.open_ends else low <= quantity.default <= high
        if not undecided and not (inside and math.isfinite(quantity.default)):
            excluded = ", both excluded" if quantity.open_ends else ""
            bounds = f"within its bounds, {low:g} and {high:g}{excluded}"
            must = "a finite number" if inside or math.isnan(quantity.default) else bounds
            yield f"whose {name} has the default {quantity.default:g}, which must be {must}."
    if quantity.scale is not None and not quantity.scale > 0.0:
        yield f"whose {name} has the scale {quantity.scale:g}, which must be above 0."
