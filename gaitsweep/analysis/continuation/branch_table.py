"""Tables of branches: a record for each point of a branch; of stationary points, in the terms of the flow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Complex, Float, Int

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.bifurcation_tests import multipliers_of
from gaitsweep.analysis.continuation.floquet_multipliers import critical_multiplier
from gaitsweep.analysis.continuation.newton import ConservedConstraints
from gaitsweep.analysis.continuation.normal_forms import coefficient
from gaitsweep.engine.poincare.maps import Map
from gaitsweep.engine.poincare.stationary_map import StationaryMap, eigenvalues

# Columns of each point of a branch, beside its parameters, observables and drifts.
_OF_POINT = (
    *("multiplier", "multiplier_re", "multiplier_im", "unstable", "stable"),
    *("special", "corrections", "end"),
)
# Bifurcations of the flow, by those of fixed points of its map.
FLOW_NAMES = {
    "neimark_sacker": "hopf",
    "resonance_1_1": "bogdanov_takens",
    "fold_neimark_sacker": "fold_hopf",
    "double_neimark_sacker": "double_hopf",
    "pitchfork_neimark_sacker": "pitchfork_hopf",
    "chenciner": "generalized_hopf",
}
# Columns of stationary points, and those that have the step of the map in them.
OF_FLOW = ("eigenvalue_re", "eigenvalue_im", "coefficient", "hopf_frequency", "hopf_period")
OF_MAP = ("multiplier", "multiplier_re", "multiplier_im", "time")


class BranchTable:
    """Collects one record for each point of n branches.

    Args:
        mapping, parameter: the map and the continuation parameter.
        values: other parameters shown in the records, a number or one for each branch (n,).
        observed: the names of the map's observables.
        n: number of branches.
        constraints: the conserved quantities that are constrained.
        with_points: each record has its `BranchPoints` of one point as `at`.
        crossing: records have the number of their `branch`, since a row may have several.
    """

    def __init__(
        self,
        mapping: Map,
        parameter: str,
        values: dict[str, Float[np.ndarray, " ..."]],
        observed: Sequence[str],
        n: int,
        constraints: ConservedConstraints,
        with_points: bool = False,
        crossing: bool = False,
    ) -> None:
        self._mapping, self.parameter, self._with_points = mapping, parameter, with_points
        self._values = {k: np.broadcast_to(v, (n,)) for k, v in values.items() if k != parameter}
        self._observed = list(observed)
        self._constrained = [mapping.conserved[k].name for k in constraints.which]
        self._records: list[list[dict[str, Any]]] = [[] for _ in range(n)]
        self._crossing = crossing
        self._rows = list(range(n))  # the row of each branch
        self._branches = [0] * n  # the number of each branch among those of its row
        self._next = [1] * n  # the number of the next branch of each row

    def add_branch(self, number: int) -> int:
        """Add a further branch, of the row of the branch `number`, and return its number."""
        row = self._rows[number]
        self._rows.append(row)
        self._branches.append(self._next[row])
        self._next[row] += 1
        self._records.append([])
        return len(self._records) - 1

    def counts(self, numbers: Int[np.ndarray, " branches"]) -> Int[np.ndarray, " branches"]:
        """The number of records of each of these branches, (n,)."""
        return np.array([len(self._records[number]) for number in numbers])

    def records(self, number: int) -> list[dict[str, Any]]:
        """The records of one branch."""
        return self._records[number]

    def end(self, numbers: Int[np.ndarray, " branches"], reason: str) -> None:
        """Note in the last record of each of these branches (n,) why it ends."""
        for number in numbers:
            self._records[number][-1]["end"] = reason

    def add_failed(self, number: int, parameter: float, reason: str) -> None:
        """Add the only record of a branch that has no first point, with the reason.

        Args:
            number: the number of the branch.
            parameter: the value of the continuation parameter there.
            reason: why there is no point.
        """
        self._records[number].append({**self._head(number, parameter), "end": reason})

    def _head(self, number: int, parameter: float) -> dict[str, Any]:
        """The first columns of the next record of the branch `number`."""
        row = self._rows[number]
        head = {"row": row, "point": len(self._records[number])}
        if self._crossing:
            head["branch"] = self._branches[number]
        values = {name: column[row] for name, column in self._values.items()}
        return {**head, self.parameter: parameter, **values}

    def write(
        self,
        numbers: Int[np.ndarray, " branches"],
        problem: ContinuationProblem,
        branch_points: BranchPoints,
        special: Sequence[str],
        *,
        tolerance: float = 0.0,
    ) -> None:
        """Add a record for each of n branches.

        Args:
            numbers: the numbers of the branches (n,).
            problem: the continuation problem of the branches.
            branch_points: a point of each.
            special: the bifurcation (n,) at each point, or "".
            tolerance: distance outside the unit circle from which multipliers count as unstable.
        """
        if not len(numbers):
            return
        factors = multipliers_of(problem, branch_points)
        for k, number in enumerate(numbers):
            unstable = int(np.sum(np.abs(factors[k]) > 1.0 + tolerance))
            self._records[number].append(
                {
                    **self._head(int(number), float(branch_points.parameter[k])),
                    **{name: float(column[k]) for name, column in branch_points.images.observed.items()},
                    **{
                        f"drift_{name}": branch_points.drift[k, i] for i, name in enumerate(self._constrained)
                    },
                    "multiplier": float(np.abs(factors[k, 0])),
                    "multiplier_re": float(factors[k, 0].real),
                    "multiplier_im": float(factors[k, 0].imag),
                    "unstable": unstable,
                    "stable": unstable == 0,
                    "special": special[k],
                    "corrections": int(branch_points.corrections[k]),
                    "end": "",
                    **({"at": branch_points[[k]]} if self._with_points else {}),
                    **_of_flow(problem[np.array([k])], branch_points[[k]], factors[k], special[k]),
                }
            )

    def table(self) -> pd.DataFrame:
        """All records; the columns are the same where no branch has a fixed point."""
        branch = ["branch"] if self._crossing else []
        head = ("row", "point", *branch, self.parameter, *self._values, *self._observed)
        drifts = (f"drift_{name}" for name in self._constrained)
        columns = [*head, *drifts, *_OF_POINT, *(["at"] if self._with_points else [])]
        columns += ["coefficient", "hopf_frequency"] if isinstance(self._mapping, StationaryMap) else []
        table = pd.DataFrame([record for branch in self._records for record in branch], columns=columns)
        table = in_terms_of_flow(self._mapping, table)
        if not self._crossing:
            return table
        table = table.sort_values(["row", "branch", "point"], kind="stable", ignore_index=True)
        # one number is left out before each further branch
        table["point"] = table.groupby("row").cumcount() + table["branch"]
        return table


def _of_flow(
    problem: ContinuationProblem, at: BranchPoints, factors: Complex[np.ndarray, " multipliers"], special: str
) -> dict[str, float]:
    """Columns of one stationary point (1,): the normal form's coefficient, and a Hopf point's frequency."""
    if not isinstance(problem.mapping, StationaryMap):
        return {}
    record = {"coefficient": coefficient(problem, at, special), "hopf_frequency": float("nan")}
    if special == "neimark_sacker":
        pair = np.array([critical_multiplier(factors, special)])
        record["hopf_frequency"] = float(np.imag(eigenvalues(pair, at.images.observed["time"]))[0])
    return record


def in_terms_of_flow(mapping: Map, table: pd.DataFrame) -> pd.DataFrame:
    """A table of fixed points or of curves of them; of stationary points, in the terms of the flow.

    The eigenvalue with the largest real part (1/s), or on a curve the critical one, is in place of the
    multiplier; `hopf_frequency` (rad/s) and `hopf_period` (s) are those of the cycles that begin there.
    """
    if not isinstance(mapping, StationaryMap) or "time" not in table:
        return table
    multipliers = table["multiplier_re" if "multiplier_re" in table else "multiplier"].to_numpy(complex)
    if "multiplier_im" in table:
        multipliers = multipliers + 1j * table["multiplier_im"].to_numpy(float)
    step = table["time"].to_numpy(float)
    with np.errstate(invalid="ignore"):  # of records without a point
        factors = eigenvalues(multipliers, step)
    renamed = {name: table[name].replace(FLOW_NAMES) for name in ("special", "end", "kind") if name in table}
    table = table.assign(**renamed, eigenvalue_re=np.real(factors), eigenvalue_im=np.imag(factors))
    if "kind" in table:
        table["hopf_frequency"] = np.where(table["kind"] == "hopf", np.abs(np.imag(factors)), np.nan)
    if "hopf_frequency" in table:
        table["hopf_period"] = 2.0 * np.pi / table["hopf_frequency"]
    if "coefficient" in table:
        # those of the map x + h a x^2, of the flow x' = a x^2
        table["coefficient"] /= np.where(table["special"] == "hopf", 1.0, step)
    return table.drop(columns=[name for name in OF_MAP if name in table])
