"""Functions of many rows by NumPy, and rows opened by a kernel: as JAX computes them."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaitsweep.contract import Model
from gaitsweep.engine.kernel import lanes, row_functions
from gaitsweep.engine.kernel.lanes import kernel_of
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.numerics import STEP_FACTOR, Numerics
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.engine.recorders.settle import SettleRecorder
from gaitsweep.engine.sweep.lane import OneLane, started_row
from gaitsweep.models.sampled_points import sampled_points
from gaitsweep.papers.ambe2021.multilegged.model import Multilegged
from gaitsweep.papers.aoi2011.waist_quadruped.model import WaistQuadruped
from gaitsweep.papers.fukuoka2015.planar_quadruped.model import PlanarQuadruped
from toy_model import Toy

RANDOM = np.random.default_rng(20261126)


def _of_one(values: dict[str, Any], matrix: Any) -> Any:
    x, flag = values["x"], values["x"] > 0.3
    turned = jnp.stack([jnp.sin(x), jax.lax.erf(x)]) @ matrix
    return {"turned": turned, "flag": flag, "count": jnp.sum(matrix > x), "root": jnp.sqrt(x - 0.5) * 0.0}


def _by_cholesky(values: dict[str, Any], matrix: Any) -> Any:
    return {**_of_one(values, matrix), "factor": jnp.linalg.cholesky(matrix @ matrix.T + jnp.eye(2))}


@pytest.mark.parametrize("function", [_of_one, _by_cholesky])
@pytest.mark.parametrize("rows", [0, 1, 7, 23])
@pytest.mark.parametrize("all_rows", [False, True])
def test_functions_of_rows_agree_with_jax(
    function: Any, rows: int, all_rows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Products with zero may be NaN, and XLA computes operations that scalar programs lack."""
    monkeypatch.setattr(row_functions, "_ROWS_AT_A_TIME", 10)
    given = {"x": RANDOM.uniform(0.0, 1.0, rows)}, RANDOM.normal(size=(rows, 2, 2))
    mine, right = over_rows(function, all_rows=all_rows)(*given), jax.vmap(function)(*given)
    assert mine.keys() == right.keys()
    for name, column in mine.items():
        assert column.dtype == right[name].dtype
        np.testing.assert_allclose(column, right[name], rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(np.isnan(mine["root"]), given[0]["x"] < 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("model", [Multilegged(), WaistQuadruped(), PlanarQuadruped()], ids=lambda m: m.name)
def test_kernels_open_rows_as_xla_does(model: Model) -> None:
    values, starts = sampled_points(model, 5)
    starts = {**starts, STEP_FACTOR: np.ones(5)}
    kernel = kernel_of(model, SettleRecorder(model), Numerics().resolve(model), None)
    by_kernel = kernel.open(values, starts)
    by_xla = lanes.opened_by_xla(kernel.lane)(values, starts)
    for mine, right in zip(by_kernel, by_xla, strict=True):
        np.testing.assert_allclose(mine, right, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_recorders_and_reports_share_the_program_of_starts_and_rows_keep_their_bits() -> None:
    """It is the slow one to compile; slots are those of one program of start and recorder."""
    model = Toy()
    numerics = Numerics(dt=1e-2).resolve(model)
    values, starts = sampled_points(model, 5)
    starts = {**starts, STEP_FACTOR: np.ones(5)}
    before: Any = lanes._started_by_xla(model, numerics.dtype, None)
    for recorder in (SettleRecorder(model), CrossingRecorder(model, crossings=3)):
        lane = OneLane(model, recorder, numerics)
        opened = lanes.opened_by_xla(lane)(values, starts)
        whole = jax.jit(jax.vmap(lanes._opening_of_one(lane.open)))(values, starts)
        for mine, right in zip(opened, whole, strict=True):
            np.testing.assert_array_equal(mine, right)

    def function(params: Any, state: Any) -> Any:
        """As remarks on starts do, with an operation that no scalar program has."""
        matrix = jnp.eye(2) + jax.tree.leaves(state)[0].ravel()[0] ** 2
        return model.period(params), jnp.linalg.cholesky(matrix)

    of_rows = lanes.over_started_rows(function, "", model, numerics.dtype, None)
    many = np.arange(lanes._BATCH + 3) % 5
    for rows in (many, many[:5], many[:0]):
        values_of_some: Any = {name: column[rows] for name, column in values.items()}
        starts_of_some: Any = {name: starts[name][rows] for name in starts if name != STEP_FACTOR}
        of_some = values_of_some, starts_of_some
        right = jax.vmap(function)(*jax.vmap(partial(started_row, model, numerics.dtype, None))(*of_some))
        for mine, theirs in zip(of_rows(*of_some), right, strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-14, atol=0.0)
    assert lanes._started_by_xla(model, numerics.dtype, None) is before
    assert before._cache_size() == 1
