"""Grammar of a job's `vary`: groups of axes, whose combinations are the rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from gaitsweep import near_miss
from gaitsweep.contract import Quantity
from gaitsweep.design.axes import AXIS_KINDS, MAX_LISTED, Axis, ListAxis, RangeAxis, Sample
from gaitsweep.expression import VARY_GROUPS
from gaitsweep.schema.diagnostics import Diagnostic, Path, dotted, quoted, unknown_field
from gaitsweep.schema.strict_model import read_model

MAX_ROWS = 10**9
MAX_DRAWN = 2 * 10**7  # numbers of random and sobol points, which are in memory while a job runs

_MAX_COUNTED = 10**30  # rows, beyond which their number is not computed
_LONG = 1000  # points of a list that is converted at once, if its points are plain numbers


@dataclass(frozen=True)
class Group:
    """Names that vary together: an axis, a `zip` or a `sample`; `paths` are their paths in the job."""

    axes: Mapping[str, Axis]
    paths: Mapping[str, Path] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names that vary together."""
        return tuple(self.axes)

    @property
    def length(self) -> int:
        """Number of points."""
        return next(iter(self.axes.values())).length

    @property
    def drawn(self) -> bool:
        """Whether its points are random or form a Sobol sequence."""
        return any(axis.drawn for axis in self.axes.values())


@dataclass
class Vary:
    """Result of reading `vary`: its groups, its normal form, and its diagnostics.

    `quantities`: the model's parameters and starts; empty while the model is unknown.
    """

    quantities: Mapping[str, Quantity]
    groups: list[Group] = field(default_factory=list)
    plain: dict[str, Any] = field(default_factory=dict)
    diagnostics: list[Diagnostic] = field(default_factory=list)

    def refuse(self, path: Path, text: str) -> None:
        """Add a diagnostic."""
        self.diagnostics.append(Diagnostic(path, text))


class _ReadAxis(NamedTuple):
    """An axis, and its normal form in a job."""

    axis: Axis
    plain: dict[str, Any]


def read_vary(raw: Any, quantities: Mapping[str, Quantity], refuse: Callable[[str], str | None]) -> Vary:
    """Read the groups of `vary`.

    Args:
        raw: the mapping as written: axes by name; `zip` and `sample` with a group or a list of groups.
        quantities: the model's parameters and starts; empty while the model is unknown.
        refuse: function from a name to the reason why it cannot vary (the end of a message), or None.

    Example:
        Groups multiply, and the axes of a `zip` vary together:

        >>> from gaitsweep.design.vary import read_vary
        >>> plain = {"beta": [0.5, 0.6], "zip": {"x": [1.0, 2.0, 3.0], "y": {"linspace": [0.0, 1.0, 3]}}}
        >>> vary = read_vary(plain, quantities={}, refuse=lambda name: None)
        >>> [(group.names, group.length) for group in vary.groups]
        [(('beta',), 2), (('x', 'y'), 3)]
        >>> vary.diagnostics
        []
    """
    vary = Vary(quantities)
    if raw is None:
        return vary
    if not isinstance(raw, Mapping):
        vary.refuse(("vary",), f"is {quoted(raw)}, but must be a mapping of names to axes (name: axis).")
        return vary
    for name, value in raw.items():
        path: Path = ("vary", str(name))
        if name in VARY_GROUPS:
            read = _read_zip if name == "zip" else _read_sample
            if isinstance(value, list) and value:
                vary.plain[name] = [read(item, (*path, place), vary) for place, item in enumerate(value)]
            else:
                vary.plain[name] = read(value, path, vary)
        elif (of_name := _read_axis(str(name), value, path, vary)) is not None:
            vary.groups.append(Group({str(name): of_name.axis}, {str(name): path}))
            vary.plain[str(name)] = of_name.plain
    _check_names(vary, refuse)
    _check_size(vary)
    return vary


def _check_size(vary: Vary) -> None:
    """Refuse too many rows or drawn points, without drawing them."""
    rows = 1
    for group in vary.groups:  # thousands of axes would make a number of thousands of digits
        rows = min(rows * group.length, _MAX_COUNTED + 1)
    if rows > MAX_ROWS:
        number = f"{rows}" if rows <= _MAX_COUNTED else "more than 1e30"
        vary.refuse(("vary",), f"gives {number} rows; at most {MAX_ROWS} are allowed.")
    drawn = sum(group.length * len(group.axes) for group in vary.groups if group.drawn)
    if drawn > MAX_DRAWN:
        text = f"draws {drawn} numbers (points times names); at most {MAX_DRAWN} are allowed."
        vary.refuse(("vary",), text)


def _read_axis(name: str, value: Any, path: Path, vary: Vary) -> _ReadAxis | None:
    """Read an axis; None with a diagnostic in `vary` if it has errors."""
    fields = _axis_fields(value)
    if fields is None:
        text = f"is {quoted(value)}, but must be a list or one of {', '.join(AXIS_KINDS)}"
        vary.refuse(path, f"{text}; a single value belongs under params.")
        return None
    kinds = [kind for kind in AXIS_KINDS if kind in fields]
    if len(kinds) != 1:
        vary.diagnostics.append(_about_kinds(fields, kinds, path))
        return None
    kind = kinds[0]
    if kind == "values" and isinstance(fields["values"], (list, tuple, np.ndarray)):
        count = len(fields["values"])
        if count > MAX_LISTED:
            text = f"has {count} points; a list may have at most {MAX_LISTED}: use linspace or a sample."
            vary.refuse((*path, "values"), text)
            return None
        fields["values"] = list(fields["values"])
        if bool in set(map(type, fields["values"])):
            fields["values"] = [_read_switch(item, vary.quantities.get(name)) for item in fields["values"]]
    if (numbers := _many_numbers(fields)) is not None:
        return _ReadAxis(ListAxis(tuple(numbers)), {"values": numbers})
    written = read_model(AXIS_KINDS[kind], fields, path, vary.diagnostics, f"an axis ({kind})")
    if written is None:
        return None
    axis = written.axis(name)
    _check_ends(axis, (*path, kind), vary)
    return _ReadAxis(axis, written.model_dump(mode="json"))


def _axis_fields(value: Any) -> dict[str, Any] | None:
    """Return the fields of an axis, for which a list is short; None for values that are no axis."""
    if isinstance(value, np.ndarray) and value.ndim:
        is_list = value.ndim == 1 and len(value) <= MAX_LISTED
        return {"values": value.tolist() if is_list else value}
    if isinstance(value, list | tuple):
        return {"values": list(value)}
    return dict(value) if isinstance(value, Mapping) else None


def _many_numbers(value: dict[str, Any]) -> list[float] | None:
    """Return a long list of plain numbers, which are converted at once; None for other axes."""
    listed = value.get("values")
    if set(value) != {"values"} or not isinstance(listed, list) or len(listed) < _LONG:
        return None
    if {type(item) for item in listed} - {int, float}:
        return None
    try:
        numbers = np.asarray(listed, np.float64) + 0.0  # -0.0 becomes 0.0, as in `read_number`
    except OverflowError:
        return None
    return numbers.tolist() if np.isfinite(numbers).all() else None


def _about_kinds(value: Mapping[str, Any], kinds: list[str], path: Path) -> Diagnostic:
    """Return the diagnostic of an axis that has no form, an unknown one, or several."""
    if kinds:
        return Diagnostic(path, f"has {' and '.join(kinds)}, but an axis must have only one of them.")
    if not value:
        return Diagnostic(path, f"is empty, but must have one of {', '.join(AXIS_KINDS)}.")
    for key in value:
        if key not in ("at", "seed"):
            return unknown_field((*path, str(key)), "an axis", AXIS_KINDS)
    return Diagnostic(path, f"has no points. {near_miss.allowing(AXIS_KINDS)}")


def _read_switch(item: Any, quantity: Quantity | None) -> Any:
    """Convert true and false to 1 and 0 for a quantity from 0 to 1; return other items unchanged."""
    if quantity is None or not isinstance(item, bool):
        return item
    is_switch = quantity.low == 0.0 and quantity.high == 1.0 and not quantity.open_ends
    return float(item) if is_switch else item


def _read_zip(value: Any, path: Path, vary: Vary) -> dict[str, Any]:
    """Return the normal form of a `zip`, and add its group and diagnostics to `vary`."""
    if not isinstance(value, Mapping) or not value:
        text = "must be a mapping of names to axes of equal length (name: axis)."
        vary.refuse(path, f"is {quoted(value)}, but {text}")
        return {}
    axes: dict[str, Axis] = {}
    plain: dict[str, Any] = {}
    for name, written in value.items():
        of_name = _read_axis(str(name), written, (*path, str(name)), vary)
        if of_name is not None:
            axes[str(name)], plain[str(name)] = of_name
    lengths = {name: axis.length for name, axis in axes.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} has {length}" for name, length in lengths.items())
        vary.refuse(path, f"needs axes of equal length, but {listed}.")
    elif axes:
        vary.groups.append(Group(axes, {name: (*path, name) for name in axes}))
    return plain


def _read_sample(value: Any, path: Path, vary: Vary) -> dict[str, Any]:
    """Return the normal form of a `sample`, and add its group and diagnostics to `vary`."""
    if not isinstance(value, Mapping):
        text = f"is {quoted(value)}, but must be a mapping. {near_miss.allowing(Sample.model_fields)}"
        vary.refuse(path, text)
        return {}
    sample = read_model(Sample, dict(value), path, vary.diagnostics, "a sample")
    if sample is None:
        return {}
    axes = sample.axes()
    paths: dict[str, Path] = {name: (*path, "of", name) for name in axes}
    for name, axis in axes.items():
        _check_ends(axis, paths[name], vary)
    vary.groups.append(Group(axes, paths))
    return sample.model_dump(mode="json")


def _check_ends(axis: Axis, path: Path, vary: Vary) -> None:
    """Refuse ends whose difference overflows, and random axes that descend; equal steps may descend."""
    if not isinstance(axis, RangeAxis) or axis.formulas:
        return
    low = float(axis.low)
    high = float(axis.high)
    if axis.drawn and low > high:
        vary.refuse(path, f"goes from {low:g} to {high:g}, but the low end must come first.")
    elif not axis.logarithmic and math.isinf(high - low):
        vary.refuse(path, f"goes from {low:g} to {high:g}, but its ends must be less than 1.8e308 apart.")


def _check_names(vary: Vary, refuse: Callable[[str], str | None]) -> None:
    """Refuse names that vary twice or cannot vary."""
    first_paths: dict[str, Path] = {}
    for group in vary.groups:
        for name, path in group.paths.items():
            if name in first_paths:
                where = dotted(first_paths[name])
                vary.refuse(path, f"is also varied by {where}: remove one of the two.")
            elif (reason := refuse(name)) is not None:
                vary.refuse(path, reason)
            first_paths.setdefault(name, path)


def written_groups(vary: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the groups of `vary` as written, even unchecked: axis, zip or sample, and the fields of each."""
    if not isinstance(vary, Mapping):
        return
    for name, value in vary.items():
        if name not in VARY_GROUPS:
            yield "axis", {str(name): value}
            continue
        for group in value if isinstance(value, list) else [value]:
            if isinstance(group, Mapping):
                yield name, group


def written_names(vary: Any) -> Iterator[tuple[str, ...]]:
    """Yield the names in each group of `vary`, as written in a job."""
    for form, group in written_groups(vary):
        names = group.get("of", {}) if form == "sample" else group
        if isinstance(names, Mapping):
            yield tuple(map(str, names))


def vary_schema() -> dict[str, Any]:
    """Return the JSON schema of `vary`, for editors."""
    numbers = {"type": "array", "items": {"type": ["number", "string", "boolean"]}, "minItems": 1}
    axis = {"anyOf": [numbers, *(TypeAdapter(kind).json_schema() for kind in AXIS_KINDS.values())]}
    zipped = {"type": "object", "additionalProperties": axis, "minProperties": 1}
    sample = Sample.model_json_schema()
    return {
        "type": "object",
        "properties": {
            "zip": {
                "anyOf": [zipped, {"type": "array", "items": zipped}],
                "description": "axes that vary together",
            },
            "sample": {
                "anyOf": [sample, {"type": "array", "items": sample}],
                "description": "points of a box",
            },
        },
        "additionalProperties": axis,
    }
