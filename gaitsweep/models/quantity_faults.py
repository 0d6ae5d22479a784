"""Faults of the names, units, bounds and defaults that a model states."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gaitsweep.contract import HybridModel, Model, Quantity
from gaitsweep.dynamics.declaration_faults import faults_of_quantity
from gaitsweep.mathtext import can_be_set

_NOT_TEX = "which Matplotlib cannot set: write TeX that it knows, and \\$ for a dollar."


def quantity_faults(model: Model) -> Iterator[str]:
    """Faults of names, units, symbols, bounds, defaults and scales, as ends of sentences."""
    starts = {quantity.name for quantity in model.initial_conditions}
    settable = [*model.parameters, *model.initial_conditions]
    recorded = {
        "observables": model.observables,
        "signals": model.signals,
        "label_fields": model.label_fields,
    }
    for where, quantities in {"parameters or initial_conditions": settable, **recorded}.items():
        names = [quantity.name for quantity in quantities]
        for name in dict.fromkeys(names):
            if names.count(name) > 1:
                yield f"whose {where} have the name {name} twice: rename one."
            if not name.isidentifier():
                must = "names must consist of letters, digits and underscores"
                yield f"whose {where} have the name {name!r}: {must}."
        for quantity in quantities:
            yield from _faults_of_quantity(quantity, is_start=quantity.name in starts)
    if all(quantity.scale == math.inf and not quantity.circular for quantity in model.observables):
        yield "whose observables all have an infinite scale, so that each row would settle at once."
    hidden = {quantity.name for quantity in settable} & {quantity.name for quantity in model.signals}
    for name in sorted(hidden):
        hides = "has the name of a parameter or start and would hide it in a trace"
        yield f"whose signal {name} {hides}: rename it."
    if not model.gaits or len(set(model.gaits)) < len(model.gaits):
        yield f'whose gaits are {model.gaits}: there must be at least one name ("none"), without repetitions.'
    named = {
        "a gait": model.gaits,
        "an event": model.guard_names if isinstance(model, HybridModel) else (),
        "a limb": [limb.name for limb in model.limbs],
    }
    for what, names in named.items():
        for name in names:
            if isinstance(name, str) and not can_be_set(name):
                yield f"which has {what} named {name!r}, {_NOT_TEX}"


def _faults_of_quantity(quantity: Quantity, *, is_start: bool) -> Iterator[str]:
    """Faults of one quantity, as ends of sentences."""
    texts = {"symbol": f"${quantity.symbol}$", "unit": quantity.unit, "meaning": quantity.meaning}
    for field, text in texts.items():
        if getattr(quantity, field) and not can_be_set(text):
            yield f"whose {quantity.name} has the {field} {getattr(quantity, field)!r}, {_NOT_TEX}"
    yield from faults_of_quantity(quantity, is_start)
