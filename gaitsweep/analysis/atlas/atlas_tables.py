"""The table of an atlas, and its parts: gaits, branches, bifurcations on them, curves in two parameters."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
from jaxtyping import Bool

from gaitsweep.analysis.atlas.atlas import BranchAtlas
from gaitsweep.analysis.atlas.branch import ON_BRANCH, Branch, Record, coordinates_of, text_of
from gaitsweep.analysis.atlas.order_changes import event_columns
from gaitsweep.analysis.atlas.periodic_orbits import OrbitSearch, polished, with_images
from gaitsweep.analysis.atlas.plane_curves import with_suffixes
from gaitsweep.analysis.continuation.arclength_step import BranchPoints
from gaitsweep.analysis.continuation.branch_points import CROSSINGS
from gaitsweep.analysis.continuation.branch_table import in_terms_of_flow
from gaitsweep.engine.poincare.maps import Points

Mask = Bool[np.ndarray, " records"]
# Entries of a record that are not columns, or columns of the atlas alone.
_NOT_COLUMNS = ("row", "point", "at", "events", "changes")
# Bifurcations on two branches are one if their parameters differ by less, as a share of the range.
SAME_VALUE = 1e-8
# Crossings of branches at such a value are one if their coordinates differ by less, relative to their size.
SAME_POINT = 1e-6
# Numbers of a record that only some records have.
_NOT_A_NUMBER = dict.fromkeys(("coefficient", "reached", "error"), float("nan"))


def atlas_table(atlas: BranchAtlas, search: OrbitSearch, at: float) -> pd.DataFrame:
    """The table of the branches of an atlas.

    Args:
        atlas: the atlas.
        search: the search whose orbits were followed.
        at: the value of the parameter there.

    Returns:
        One record a point of a branch: row, branch, period, depth, begins (the branch at whose bifurcation it
        begins; -1: it leads through an orbit of the search), and the columns of `continuation`, with
        `coefficient`, the normal form's; missing (`OrbitSearch.missing`), drawn_starts (those of its row),
        and where the parameter is `at`: found (how many searches found the orbit; 0: its branch alone leads
        there; -1 at other points), reached, error and symmetry of an `Orbit`; `event_columns`, change (what
        changes in the order of events at a corner), and `stored_point`, the text of the point.
    """
    records: list[Record] = []
    numbers = _numbers(atlas.branches)
    listed: dict[int, list[Points]] = {}
    for branch, number in zip(atlas.branches, numbers, strict=True):
        of_row = {"missing": search.missing(branch.row), "drawn_starts": search.drawn(branch.row)}
        begins = -1 if branch.begins is None else numbers[branch.begins[0]]
        of_branch = {"period": branch.period, "depth": branch.depth, "begins": begins, **_NOT_A_NUMBER}
        for index, record in enumerate(branch.records):
            head = {"row": branch.row, "branch": number, "point": index, "found": -1, **of_row}
            change = ", ".join(record.get("changes", ()))
            head |= {**of_branch, "symmetry": "", "change": change, **event_columns(record["events"])}
            head |= {"stored_point": text_of(record["at"])}
            numbers_of_point = {k: v for k, v in record.items() if k not in _NOT_COLUMNS}
            head |= with_suffixes(numbers_of_point, head)
            if record[atlas.parameter] == at:
                head |= _gait(atlas, search, branch, record["at"], listed.setdefault(branch.row, []))
            records.append(head)
    return in_terms_of_flow(atlas.mapping, pd.DataFrame(records))


def _numbers(branches: list[Branch]) -> list[int]:
    """The number of each branch among those of its row."""
    rows = [branch.row for branch in branches]
    return [rows[:index].count(row) for index, row in enumerate(rows)]


def _gait(
    atlas: BranchAtlas, search: OrbitSearch, branch: Branch, at: BranchPoints, listed: list[Points]
) -> Record:
    """Facts about the orbit at a point of a branch; none if it is `listed`, and else it is added there.

    Args:
        atlas: the atlas.
        search: the search whose orbits were followed.
        branch: the branch.
        at: the point (1,).
        listed: the gaits of the branch's row that have a record, with their images.
    """
    mapping = atlas.mapping
    if any(np.min(mapping.distance(gait.at, at.points.at)) < ON_BRANCH for gait in listed):
        return {}
    values = branch.problem.values_at(at.parameter)
    images = np.concatenate([image.at for image in with_images(mapping, at.points, values)])
    orbits = [orbit for orbit in search.of_row(branch.row) if orbit.period == branch.period]
    distances = [float(np.min(mapping.distance(orbit.points.at[:, None], images))) for orbit in orbits]
    nearest = int(np.argmin(distances)) if distances else -1
    if nearest >= 0 and distances[nearest] < ON_BRANCH:
        orbit, distance = orbits[nearest], distances[nearest]
    else:
        (orbit,) = polished(mapping, at.points, np.array([branch.row]), values, branch.period, atlas.fix)
        if orbit is None:
            return {"found": 0}
        distance = float(np.min(mapping.distance(orbit.points.at, at.points.at)))
    listed += with_images(mapping, orbit.points, values)
    return {
        "found": orbit.hits,
        "reached": orbit.reached,
        "error": max(orbit.error, distance),
        "symmetry": ", ".join(orbit.symmetry),
    }


def atlas_tables(table: pd.DataFrame, parameter: str) -> dict[str, pd.DataFrame]:
    """Divide the table of an atlas.

    Args:
        table: the table of a run of kind atlas.
        parameter: the parameter along which its branches are followed.

    Returns:
        `gaits`: all gaits where they were searched, one record each. `branches`: one record for each point;
        `number` is the branch. `points`: the bifurcations on branches, once each. `curves`: the bifurcations
        in the plane of two parameters, one record for each point; `number` is the curve.
    """
    part = table["part"].astype(str)
    on_branch = (part == "branch").to_numpy(bool)
    masks = {
        "gaits": on_branch & (table["found"] >= 0).to_numpy(bool),
        "branches": on_branch,
        "points": on_branch & _bifurcations(table, parameter),
        "curves": ~on_branch & (part != "").to_numpy(bool),
    }
    return {name: table.iloc[np.flatnonzero(mask)].reset_index(drop=True) for name, mask in masks.items()}


def _bifurcations(table: pd.DataFrame, parameter: str) -> Mask:
    """Mask of the records of bifurcations, without those that repeat another branch's.

    A parent's flip is met again where its doubled gait ends, and a pitchfork that ends a branch is on the
    symmetric branch as well. Branches that cross have the point of both, if a search found a gait of each.
    """
    special, end = (table[name].astype(str).to_numpy(str) for name in ("special", "end"))
    row, value = table["row"].to_numpy(int), table[parameter].to_numpy(float)
    least = SAME_VALUE * (np.nanmax(value, initial=-np.inf) - np.nanmin(value, initial=np.inf))
    repeated = end == "flip"
    for k in np.flatnonzero(end == "pitchfork"):
        alike = (row == row[k]) & (special == special[k]) & (end != "pitchfork")
        repeated[k] = np.any(alike & (np.abs(value - value[k]) <= least))
    crossings = np.flatnonzero(np.isin(special, CROSSINGS) & ~repeated & ("stored_point" in table))
    places = {k: np.array(coordinates_of(table["stored_point"].iloc[k])) for k in crossings.tolist()}
    for k, other in itertools.combinations(places, 2):
        alike = row[k] == row[other] and special[k] == special[other]
        alike &= abs(value[k] - value[other]) <= least
        repeated[other] |= alike and np.allclose(places[k], places[other], SAME_POINT, SAME_POINT)
    return ~np.isin(special, ["", "nan", "kink"]) & ~repeated
