"""Curves through the bifurcations and order changes of branches, in the plane of two parameters."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from gaitsweep.analysis.atlas.branch import ON_BRANCH, Branch, Record
from gaitsweep.analysis.atlas.curves import BifurcationCurve, curve_through
from gaitsweep.analysis.atlas.order_curves import OrderChange
from gaitsweep.analysis.atlas.periodic_orbits import orbits_of, with_images
from gaitsweep.analysis.continuation.branch_follower import ArclengthSteps
from gaitsweep.analysis.continuation.lockstep import in_lockstep
from gaitsweep.analysis.continuation.stable_ranges import MARKS
from gaitsweep.engine.poincare.maps import Map, Points

# Columns that a record may itself have beside those of its curve or branch.
_OF_RECORD = ("coefficient", "change")


@dataclasses.dataclass(frozen=True)
class SecondParameter:
    """A second parameter: its name, and its range."""

    name: str
    low: float
    high: float


def plane_curves(
    mapping: Map,
    branches: Sequence[Branch],
    within: Sequence[float],
    second: SecondParameter,
    steps: ArclengthSteps,
) -> list[Record]:
    """Follow the bifurcations and the order changes of branches over a second parameter.

    Args:
        mapping: the map, not iterated.
        branches: the branches; their `problem` has the value of the second parameter.
        within: the range of the branches' parameter, two numbers.
        second: the second parameter.
        steps: lengths and number of the steps.

    Returns:
        One record a point, as of `BranchAtlas.follow_curves`.
    """
    candidates = [
        (branch, record)
        for branch in branches
        for record in branch.records
        if record["special"] in MARKS and record["special"] != "corner" and not record["end"]
    ]
    followed = in_lockstep(
        [
            curve_through(
                branch.problem,
                record["at"],
                record["special"],
                (second.name, second.low, second.high, _home(branch, second)),
                steps,
            )
            for branch, record in candidates
        ]
    )
    curves: list[BifurcationCurve] = []
    for (branch, record), curve in zip(candidates, followed, strict=True):
        images = [] if curve is None else _images(mapping, branch, record)
        if curve is None or not images:
            continue
        parameter, kind = float(record["at"].parameter[0]), record["special"]
        if not any(known.passes(branch.row, kind, image, parameter) for known in curves for image in images):
            curves.append(dataclasses.replace(curve, row=branch.row, period=branch.period))
    records: list[Record] = []
    curves_of_row: Counter[int] = Counter()
    for curve in curves:
        head = {"row": curve.row, "curve": curves_of_row[curve.row], "kind": curve.equations.kind}
        head["period"] = curve.period
        curves_of_row[curve.row] += 1
        records += [{**head, **renamed_apart(record, head)} for record in curve.records()]
    records += _order_curves(mapping, branches, within, second, curves_of_row)
    return records


def _order_curves(
    mapping: Map,
    branches: Sequence[Branch],
    within: Sequence[float],
    second: SecondParameter,
    curves_of_row: Counter[int],
) -> Iterator[Record]:
    """The records of the curves on which the order of events changes, numbered after the `curves_of_row`."""
    known: list[tuple[Branch, float, Points]] = []
    marked = [(b, record) for b in branches for record in b.records if record["special"] == "order_change"]
    for branch, record in marked:
        at, problem = record["at"], branch.problem
        parameter, images = float(at.parameter[0]), _images(mapping, branch, record)
        if any(
            (other.row, other.period) == (branch.row, branch.period)
            and abs(place - parameter) < ON_BRANCH * (problem.high - problem.low)
            and any(np.min(mapping.distance(image.at, point.at)) < ON_BRANCH for image in images)
            for other, place, point in known
        ):
            continue
        known.append((branch, parameter, at.points))
        names = [mapping.conserved[k].name for k in problem.held.which]
        change = OrderChange(
            mapping=problem.mapping,
            parameter=problem.parameter,
            second=second.name,
            within=(within, (second.low, second.high)),
            values={name: value for name, value in problem.values.items() if name != second.name},
            fix=dict(zip(names, problem.held.values.T, strict=True)),
            point=at.points,
            home=(parameter, _home(branch, second)),
            events=problem.mapping.events(at.points, problem.values_at(at.parameter))[0],
            change=record["change"],
        )
        head = {"row": branch.row, "kind": "order_change", "period": branch.period}
        head |= {"curve": curves_of_row[branch.row], "change": record["change"]}
        curve = change.curve()
        curves_of_row[branch.row] += bool(curve)
        yield from ({**head, **renamed_apart(point, head)} for point in curve)


def _home(branch: Branch, second: SecondParameter) -> float:
    """The value of the second parameter at a branch."""
    return float(np.ravel(branch.problem.values[second.name])[0])


def _images(mapping: Map, branch: Branch, record: Record) -> list[Points]:
    """The orbit at a record of a branch, and its images under the symmetries; empty where there is none."""
    values = branch.problem.values_at(record["at"].parameter)
    (orbit,) = orbits_of(mapping, record["at"].points, values, branch.period)
    return [] if orbit is None else with_images(mapping, orbit, values)


def renamed_apart(record: Record, head: Record) -> Record:
    """A record whose observables with the name of a column of `head` end in _n, as in a job's table."""
    return {f"{k}_n" if k in head and k not in _OF_RECORD else k: v for k, v in record.items()}
