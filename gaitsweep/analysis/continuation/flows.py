"""Stationary points in the terms of flows: eigenvalues, Hopf points, and the cycles that begin there."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Float

from gaitsweep.analysis.continuation.normal_forms import hopf_form
from gaitsweep.engine.poincare.maps import Map, Points, Values
from gaitsweep.engine.poincare.stationary_map import StationaryMap, eigenvalues, linearised_flow

# What bifurcations of fixed points are for the flow.
NAMES = {
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
# Displacement of a parameter, relative to its size, for the rate of an eigenvalue along a branch.
BESIDE = 1e-5


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
    renamed = {name: table[name].replace(NAMES) for name in ("special", "end", "kind") if name in table}
    table = table.assign(**renamed, eigenvalue_re=np.real(factors), eigenvalue_im=np.imag(factors))
    if "kind" in table:
        table["hopf_frequency"] = np.where(table["kind"] == "hopf", np.abs(np.imag(factors)), np.nan)
    if "hopf_frequency" in table:
        table["hopf_period"] = 2.0 * np.pi / table["hopf_frequency"]
    if "coefficient" in table:
        # those of the map x + h a x^2, of the flow x' = a x^2
        table["coefficient"] /= np.where(table["special"] == "hopf", 1.0, step)
    return table.drop(columns=[name for name in OF_MAP if name in table])


def hopf_cycle(
    mapping: StationaryMap, at: Points, values: Values, parameter: str, amplitude: float, count: int
) -> pd.DataFrame:
    """The cycle of an amplitude that begins at a Hopf point (1,), to second order.

    Args:
        mapping: the map.
        at: the Hopf point.
        values: the parameters there.
        parameter: the parameter that moves away from there.
        amplitude: the largest displacement of the cycle, in the units of the coordinates.
        count: the number of its points.

    Returns:
        One record a point: time (s), the coordinates, the parameter's value at which the cycle has this
        amplitude, and its period (s).
    """
    form, program = hopf_form(mapping, at, values), linearised_flow(mapping)
    values_at = {name: column[0] for name, column in mapping.complete(values, 1).items()}
    x, modes, value = at.at[0], at[0].modes, values_at[parameter]

    def linearised(
        share: float, x: Float[np.ndarray, " coordinates"]
    ) -> tuple[Float[np.ndarray, " coordinates"], Float[np.ndarray, "coordinates coordinates"]]:
        rates, jacobian = program({**values_at, parameter: value + share}, x, modes)
        return np.asarray(rates), np.asarray(jacobian)

    small = BESIDE * (1.0 + abs(value))
    slope = (linearised(small, x)[0] - linearised(-small, x)[0]) / (2.0 * small)
    along = np.linalg.solve(-linearised(0.0, x)[1], slope)
    ahead, behind = (linearised(d, x + d * along)[1] for d in (small, -small))
    growth = np.real(form.p @ (ahead - behind) @ form.q) / (2.0 * small)
    size = amplitude / np.max(np.abs(form.q)) / 2.0
    change = -form.frequency * form.l1 * size**2 / growth
    period = 2.0 * np.pi / form.frequency
    time = period * np.arange(count) / count
    z = size * np.exp(1j * form.frequency * time)[:, None]
    points = x + change * along + 2.0 * (z * form.q).real + np.abs(z) ** 2 * form.h11 + (z**2 * form.h20).real
    columns = {quantity.name: points[:, k] for k, quantity in enumerate(mapping.coordinates)}
    return pd.DataFrame({"time": time, **columns, parameter: value + change, "period": period})
