"""A number of a row that a recorder outside the package declares: one declaration, and it is in the table."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from jaxtyping import Array, Float
from pydantic import Field

import gaitsweep as gs
from gaitsweep import kinds
from gaitsweep.contract import Model, Params, Quantity
from gaitsweep.design import Design
from gaitsweep.engine.carry import Carry, Halt
from gaitsweep.engine.recorders.recorder import (
    Beginning,
    LaneRecord,
    PollResult,
    Readings,
    Recorder,
    RunningRows,
)
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.job import Job
from gaitsweep.kinds.columns import GAIT, STATUS, Column
from gaitsweep.kinds.run_kind import Cost
from gaitsweep.row_outcome import RowNumber, RowOutcome
from gaitsweep.table import ResultDirectory, Snapshot
from toy_model import launches

FASTEST = RowNumber(
    "fastest", np.float64, quantity=Quantity("fastest", "m/s", "largest launch after a bounce")
)


@dataclasses.dataclass(frozen=True)
class FastestRecorder(Recorder):
    """Ends rows as a `SettleRecorder` does, and keeps the largest first observable of their crossings."""

    model: Model
    numbers = (*Recorder.numbers, FASTEST)

    @property
    def settling(self) -> SettleRecorder:
        return SettleRecorder(self.model)

    @property
    def names(self) -> tuple[str, ...]:
        return self.settling.names

    def stop(self, params: Params) -> Float[Array, ""]:
        return self.settling.stop(params)

    def max_attempts(self, params: Params, dt: Float[Array, ""] | float) -> Float[Array, ""]:
        return self.settling.max_attempts(params, dt)

    def begin(self, params: Params, carry: Carry) -> Beginning:
        record, sample, keep = self.settling.begin(params, carry)
        record = dataclasses.replace(record, numbers=self.unsampled(params, carry)[0].numbers)
        return Beginning(record, sample, keep)

    def record(self, params: Params, carry: Carry, record: LaneRecord) -> PollResult:
        result = self.settling.record(params, carry, record)
        before = record.numbers["fastest"]
        now = jnp.where(carry.halt == Halt.CROSSING, result.record.last[0], before)
        numbers = {**result.record.numbers, "fastest": jnp.maximum(before, now)}
        return result._replace(record=dataclasses.replace(result.record, numbers=numbers))

    def readings(self, rows: RowOutcome) -> Readings | None:
        return self.settling.readings(rows)

    def progress(self, rows: RunningRows, typical: float) -> Float[np.ndarray, " rows"]:
        return self.settling.progress(rows, typical)


class Fastest(kinds.RunKind):
    """Follow rows until they settle, with the recorder above; its columns do not name the number."""

    one_a_row: ClassVar[bool] = True
    kind: Literal["fastest"] = Field(description="fastest: rows until they settle, and their largest launch")

    def recorder(self, model: Model) -> FastestRecorder:
        return FastestRecorder(model)

    def columns(self, model: Model) -> list[Column]:
        return [STATUS, GAIT]

    def cost(self, rows: Design, cycle: float, period: float) -> Cost:
        return Cost(30 * cycle, 150 * cycle)


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    kinds.register(Fastest)
    yield
    kinds.unregister("fastest")


def without_the_number(
    directory: ResultDirectory, number: int, restored: Any = ResultDirectory.restored
) -> Any:
    """Stored rows as a version of gaitsweep wrote them in which the recorder declared no such number."""
    rows = restored(directory, number)
    return rows and dataclasses.replace(
        rows, numbers={k: v for k, v in rows.numbers.items() if k != "fastest"}
    )


@pytest.mark.parametrize("older", [False, True])
@pytest.mark.parametrize("engine", ["kernel", pytest.param("xla", marks=pytest.mark.slow)])
def test_a_declared_number_is_in_the_table_through_an_interrupt(
    tmp_path: Path, engine: str, older: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = np.linspace(0.2, 2.0, 24)
    job = Job(
        name="x",
        model="toy_model:Toy",
        vary={"launch_1": starts.tolist()},
        run={"kind": "fastest"},
        engine={"name": engine, "block": 24, "lanes": 8},
        verify=0,
    )

    def stop(done: int, total: int, rate: float, fraction: float, note: str) -> None:
        if note != "compiling" and 0 < done < total:
            raise KeyboardInterrupt

    out = tmp_path / "stopped"
    with pytest.raises(KeyboardInterrupt):
        gs.run(job, out, on_progress=stop)
    assert 0 < Snapshot.of(out).rows_open < 24  # rows that the table gets from a file of open rows
    if older:
        monkeypatch.setattr(ResultDirectory, "restored", without_the_number)
    table = gs.run(job, out).table
    assert list(table.columns) == ["row", "launch_1", "status", "gait", "fastest"]
    assert table.attrs["quantities"]["fastest"]["unit"] == "m/s"
    # the launches go to their limit from one side, so the largest is the first or the limit: events are
    # located to 1e-12 s, and a row that settles to 1e-3 has come nearer to the limit than 1e-3
    limits = [launches(start, 0.5, 0.5, 60)[[1, -1]].max() for start in starts]
    np.testing.assert_allclose(table["fastest"], limits, rtol=0, atol=1e-3)
    whole = gs.run(job, tmp_path / "whole").table
    pd.testing.assert_frame_equal(table, whole, check_exact=True)


def test_results_of_no_rows() -> None:
    with pytest.raises(ValueError, match="no results to join"):
        RowOutcome.concat([])
    assert not hasattr(RowOutcome.status, "shape")  # the class has no numbers; tools may ask for its members
