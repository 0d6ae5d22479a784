"""The animated records of the explorer: simulated again, compared with the table, encoded for the page."""

from __future__ import annotations

import html
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gaitsweep.contract import Quantity
from gaitsweep.engine.sweep.sweep_spec import SweepProgress
from gaitsweep.kinds.columns import gaits
from gaitsweep.kinds.fixed_points import FollowsFixedPoints
from gaitsweep.plot.limbs import limbs_of_model
from gaitsweep.runs.prepare import RunContext
from gaitsweep.runs.progress import Progress
from gaitsweep.runs.self_check_result import changes, circular, sizes
from gaitsweep.skeleton import LimbLook, contact_signals
from gaitsweep.status import RECURRENT, Status
from gaitsweep.view.explorer.page_format import (
    compressed,
    crossing_fields,
    html_symbol,
    json_bytes,
    motion_fields,
)
from gaitsweep.view.explorer.replay_groups import ReplayGroup, replay_groups
from gaitsweep.view.explorer.replays import BodyParts, Crossings, ReplayedRow, Replayer
from gaitsweep.view.explorer.start_map import StartMap

_MOST_SERIES = 6  # lines of one figure beside the map, unless they are angles
_NAMED = 3  # symbols in the name of a group of observables
# Differences up to this value between a row simulated again and the table are not reported: rad, or shares of
# an observable's size.
_REPORTED = 1e-2


class AnimatedRecords:
    """The animated records, simulated again, and their fields on the page.

    Args:
        shown: the records of the page.
        context: their job.
        most: largest number of animated records.
        spent: duration of the job, s.
        on_progress: progress callback.
    """

    def __init__(
        self, shown: StartMap, context: RunContext, most: int, spent: float, on_progress: Progress | None
    ) -> None:
        self._context = context
        self._on_progress = on_progress
        self._model = context.model
        self._shown = shown
        self._table = shown.table.reset_index(drop=True)
        self._groups, self._beside = replay_groups(
            shown, self._table, context, most, spent, self._on_branch_progress
        )
        self._parts: BodyParts | None = None
        self._sizes: list[tuple[float, float, float]] = []
        self.series = self._drawn_over_cycles()  # the observables over the cycles, with their ranges
        self.sentence = "The page has no animated starts."

    def fields(self, room: int) -> dict[str, Any]:
        """Simulate the records again; returns the replays that fit into `room` bytes.

        Afterwards `sentence` has their number, and `limbs` are those of the skeleton.
        """
        replays: dict[int, dict[str, Any]] = {}
        around: dict[int, Crossings] = {}
        for group in self._groups:
            replayer = group.replayer()
            windows = group.windows(float(replayer.periods.max()))
            for replayed in replayer.replayed(windows, self._on_sweep_progress(group.rows.size)):
                for record in group.records_of[replayed.row]:
                    replays[record] = self._replay(group, replayer, replayed, record)
                    around[record] = group.around(record, replayed)
            self._parts = self._parts or replayer.parts
        self._set_ranges(list(around.values()))
        walks: list[dict[str, Any]] = []
        size = 0
        for record in itertools.chain.from_iterable(group.records.tolist() for group in self._groups):
            replay = {**replays[record], "crossings": self._over_cycles(around[record])}
            size += len(compressed(json_bytes(replay)))
            if size > room:
                break
            walks.append(replay)
        self.sentence = self._sentence(walks, len(replays))
        cycles = np.concatenate([[], *(np.diff(crossings.t) for crossings in around.values())])
        return {
            "walks": walks,
            "first": self._first([replay["record"] for replay in walks]),
            "figure": self._figure(),
            "series": self.series,
            "cycle": float(np.median(cycles)) if cycles.size else 1.0,
        }

    def _first(self, animated: list[int]) -> int:
        """The record with which the page opens: one with a settled gait, animated if any is."""
        outcome = self._shown.outcome
        # the second animated record is beside a boundary, so that another outcome is near
        records = [*animated[1:2], *animated] if animated else list(range(len(outcome)))
        settled = [
            not look["hollow"] and not look["hatched"] and look["leads"] != "none"
            for look in self._shown.outcomes
        ]
        return next((record for record in records if settled[outcome[record]]), records[0])

    def _on_branch_progress(self, note: str = "", share: float = 0.0) -> None:
        """Report progress while branches are followed again."""
        if self._on_progress is not None:
            self._on_progress(0, 1, 0.0, 0.0, "following branches again")

    def _on_sweep_progress(self, rows: int) -> Callable[[SweepProgress], None]:
        """The progress callback of a sweep over `rows` rows."""

        def on_progress(now: SweepProgress) -> None:
            if self._on_progress is not None:
                done = min(round(now.share * now.rows), rows)
                self._on_progress(done, rows, done / max(now.seconds, 1e-9), done / rows, "walking")

        return on_progress

    def _replay(
        self, group: ReplayGroup, replayer: Replayer, replayed: ReplayedRow, record: int
    ) -> dict[str, Any]:
        """The fields of one animated record."""
        period = float(replayer.periods[replayed.place])
        stretches = group.stretches(record, replayed, period)
        motions = [motion for part in stretches if (motion := replayer.motion(replayed, part)) is not None]
        pictures = [motion.pictures for motion in motions if motion.pictures is not None]
        self._sizes += [(body.half, body.height, body.depth) for body in pictures]
        return {
            "record": record,
            "motions": [motion_fields(motion) for motion in motions],
            **self._differs(record, replayed),
        }

    def _over_cycles(self, crossings: Crossings) -> dict[str, Any]:
        """The observables drawn over the cycles."""
        numbers = np.array([line["number"] for line in self.series], int)
        low, high = (np.array([line[end] for line in self.series]) for end in ("low", "high"))
        return crossing_fields(crossings, numbers, low, high)

    def _differs(self, record: int, replayed: ReplayedRow) -> dict[str, Any]:
        """Describe differences between a row simulated again and the table."""
        row, run = self._table.iloc[record], self._context.job.run
        if isinstance(run, FollowsFixedPoints):  # crossings that have to give a fixed point back
            period = int(row["period"]) if "period" in row else 1
            return self._largest_change(record, replayed, range(period, period + 1), "n")
        if not run.one_a_row or str(row["status"]) not in Status.SOUND - RECURRENT:
            return {}
        difference: dict[str, Any] = {}
        if run.compared != "ends":  # rows of a fixed time end between crossings
            # the table has the same crossing of an orbit for all rows, not the last one
            last, period = int(row["cycles"]), int(row.get("attractor_period", 1))
            crossings = range(max(last + 1 - max(period, 1), 0), last + 1)
            difference = self._largest_change(record, replayed, crossings, "end")
        gait = str(gaits(self._model, np.array([replayed.gait]))[0]) if replayed.gait != -1 else "none"
        if not pd.isna(row["gait"]) and gait != str(row["gait"]):
            difference["later"] = gait
        return difference

    def _largest_change(
        self, record: int, replayed: ReplayedRow, crossings: range, suffix: str
    ) -> dict[str, Any]:
        """The largest difference of an observable from the table's, if it is reported.

        It is that at the one of the crossings which is nearest to the table: of an angle `apart`, rad, else
        of another observable `share`, of its size on the page. The table's observables are the columns with
        `suffix`.
        """
        if crossings[-1] >= len(replayed.crossings.number):
            return {}
        observables = self._model.observables
        recorded = self._table[[f"{q.name}_{suffix}" for q in observables]].to_numpy(float)
        observed = replayed.crossings.observed[crossings.start : crossings.stop]
        # of angles in rad, which are their own shares
        shares = changes(self._model, observed, recorded[record]) / sizes(observables, recorded)
        nearest = shares[np.argmin(np.nanmax(shares, axis=1, initial=0.0))]
        angles = circular(self._model)
        for name, of_kind in (("apart", nearest[angles]), ("share", nearest[~angles])):
            if (most := float(np.nanmax(of_kind, initial=0.0))) > _REPORTED:
                return {name: most}
        return {}

    def _drawn_over_cycles(self) -> list[dict[str, Any]]:
        """The observables drawn over the cycles, in groups with one unit each, angles first.

        The page draws one group at a time; `group` is its name in HTML.
        """
        kinds: dict[tuple[bool, str], list[Quantity]] = {}
        for quantity in self._model.observables:
            kinds.setdefault((not quantity.circular, quantity.unit), []).append(quantity)
        series = []
        for linear, unit in sorted(kinds, key=lambda kind: kind[0]):
            of_kind = kinds[linear, unit]
            most = _MOST_SERIES if linear else len(of_kind)  # angles are compared with each other
            for first in range(0, len(of_kind), most):
                series += self._group(of_kind[first : first + most])
        return series

    def _group(self, quantities: Sequence[Quantity]) -> list[dict[str, Any]]:
        """The fields of observables of one unit that the page draws together."""
        unit = "" if quantities[0].unit == "1" else quantities[0].unit
        symbols = [html_symbol(self._shown.table, quantity.name) for quantity in quantities]
        names = ", ".join(symbols) if len(symbols) <= _NAMED else f"{symbols[0]} ... {symbols[-1]}"
        return [
            {
                "name": quantity.name,
                "symbol": symbol,
                "unit": unit,
                "circular": quantity.circular,
                "number": self._model.observables.index(quantity),
                "group": f"{names} ({html.escape(unit)})" if unit else names,
            }
            for quantity, symbol in zip(quantities, symbols, strict=True)
        ]

    def _set_ranges(self, crossings: list[Crossings]) -> None:
        """Set the ranges of the observables drawn over the cycles."""
        for line in self.series:
            values = np.concatenate([[], *(of_record.observed[:, line["number"]] for of_record in crossings)])
            values = values[np.isfinite(values)]
            line["low"] = values.min() if values.size else 0.0
            line["high"] = values.max() if values.size else 0.0

    def _figure(self) -> dict[str, Any] | None:
        """Parts of the body in the frames, and its size; None for a model without a skeleton."""
        if self._parts is None or not self._sizes:
            return None
        half, height, depth = np.quantile(np.array(self._sizes), 0.98, axis=0)
        parts = {"limbs": list(self._parts.limbs), "bodies": list(self._parts.bodies)}
        parts |= {"springs": self._parts.springs, "note": self._parts.note}
        return {**parts, "half": half, "height": height, "depth": depth}

    @property
    def limbs(self) -> tuple[LimbLook, ...]:
        """The names and places of limbs: those of the skeleton, those of the model, or numbers."""
        if self._parts is not None and self._parts.names:
            named = zip(self._parts.names, self._parts.pairs, strict=True)
            return tuple(LimbLook(name, pair, far) for name, (pair, far) in named)
        return limbs_of_model(self._model, len(contact_signals(q.name for q in self._model.signals)))

    def _sentence(self, walks: list[dict[str, Any]], simulated: int) -> str:
        """Format the number of animated records, and of those that differ from the table."""
        starts = self._context.job.run.one_a_row or self._context.job.run.kind_name == "return_map"
        total = len(np.unique(self._table["row"])) if starts else len(self._table)
        noun = ("start" if starts else "record") + "s" * (total != 1)
        full = f"; {simulated - len(walks)} more did not fit" if len(walks) < simulated else ""
        beside = f", {self._beside} of them beside a boundary" if self._beside and not full else ""
        different = sum(not {"later", "apart", "share"}.isdisjoint(walk) for walk in walks)
        differ = f"; {different} of them differ from the table, as the page shows" if different else ""
        verb = "is" if total == 1 else "are"
        return f"{len(walks)} of {total} {noun} {verb} animated{beside}{full}{differ}."
