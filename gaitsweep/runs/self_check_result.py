"""The result of a self-check, for the manifest of its run."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from gaitsweep.contract import Quantity
from gaitsweep.errors import EXIT_STRICT, UserError
from gaitsweep.runs.sentences import HALF_THE_STEP
from gaitsweep.table.manifest import DIFFERENCES


class SelfCheckError(UserError):
    """A self-check found a difference, and the run is strict."""

    exit_code = EXIT_STRICT


@dataclasses.dataclass
class SelfCheck:
    """Result of a self-check; a row that is sensitive counts nowhere else.

    Args:
        rows: the number of rows rerun.
        of: the number of rows of the job.
        stored_differs: rows that do not reproduce their stored records with the same steps.
        status_differs: rows that end with another status with finer steps.
        gait_differs: rows with another gait.
        count_differs: rows with another number of crossings, or of another whole-numbered observable.
        sensitive: rows on a boundary, or whose moved starts change as much.
        moved: rows of which an observable or the time of a crossing changes by more than is allowed.
        unstable: rows that rest on an unstable gait.
        unstable_first: the first of them: its number, and the moving parameter or the axes there.
        by_step: rows of a model with a step of its own, of which an observable changes much with a finer one.
        largest: the largest change of each observable: of settled rows at their end, of others over their
            first crossings.
        worst: name and unit of the observable with the largest change relative to its size.
        finer: the finer steps, in words.
        verdict: passed, warned or off.
    """

    rows: int
    of: int
    stored_differs: int = 0
    status_differs: int = 0
    gait_differs: int = 0
    count_differs: int = 0
    sensitive: int = 0
    moved: int = 0
    unstable: int = 0
    unstable_first: dict[str, float] = dataclasses.field(default_factory=dict)
    by_step: int = 0
    largest: dict[str, float] = dataclasses.field(default_factory=dict)
    worst: dict[str, str] = dataclasses.field(default_factory=dict)
    finer: str = HALF_THE_STEP
    verdict: str = "passed"
    _worst_share: float = -1.0

    def record_changes(
        self,
        quantities: tuple[Quantity, ...],
        change: Float[np.ndarray, "rows quantities"],
        size: Float[np.ndarray, " ..."],
    ) -> None:
        """Update the largest changes from changes (n, quantities), where known; `size` has the same shape."""
        size = np.broadcast_to(size, change.shape)
        # an unchanged value has the share 0 even if its size is 0, as the interval of crossings at one
        # instant
        share = np.divide(change, size, out=np.where(change > 0.0, np.inf, 0.0), where=size > 0.0)
        share[np.isnan(size)] = 0.0
        for i, quantity in enumerate(quantities):
            column = change[:, i]
            known = np.isfinite(column)
            if known.any():
                most = float(column[known].max())
                self.largest[quantity.name] = max(most, self.largest.get(quantity.name, 0.0))
                if (largest := float(share[known, i].max())) > self._worst_share:
                    self._worst_share = largest
                    self.worst = {"name": quantity.name, "unit": quantity.unit}

    def judged(self) -> dict[str, Any]:
        """Return the fields for the manifest, with the verdict."""
        fields = dataclasses.asdict(self)
        del fields["_worst_share"]
        return fields | {"verdict": "warned" if any(map(fields.get, DIFFERENCES)) else "passed"}
