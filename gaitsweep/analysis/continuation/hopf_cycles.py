"""The normal form of a flow at a Hopf point, and the cycles that begin there.

Source: Kuznetsov 2004, Elements of Applied Bifurcation Theory, eq. (3.20) and section 5.4.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd

from gaitsweep.analysis.continuation.floquet_multipliers import (
    ComplexVector,
    Matrix,
    Vector,
    critical_eigenvectors,
)
from gaitsweep.engine.poincare.maps import Points, Values
from gaitsweep.engine.poincare.stationary_map import StationaryMap, flow_derivatives, linearised_flow

# Displacement of a parameter, relative to its size, for the rate of an eigenvalue along a branch.
PARAMETER_STEP = 1e-5


@dataclasses.dataclass(frozen=True)
class HopfForm:
    """The normal form of a Hopf point: z' = i frequency z + cubic z |z|^2, x = 2 Re(z q) + ...

    Attributes:
        frequency: the imaginary part of the critical eigenvalue, rad/s.
        q, p: its right and left eigenvectors, p . q = 1, |q| = 1 in the units of the coordinates.
        cubic: the cubic coefficient, 1/s.
        h11, h20: the second-order terms of x, h11 |z|^2 + Re(h20 z^2).
    """

    frequency: float
    q: ComplexVector
    p: ComplexVector
    cubic: complex
    h11: Vector
    h20: ComplexVector

    @property
    def l1(self) -> float:
        """The first Lyapunov coefficient; below 0, stable cycles begin (supercritical)."""
        return self.cubic.real / self.frequency


def hopf_form(mapping: StationaryMap, at: Points, values: Values) -> HopfForm:
    """The normal form at a Hopf point (1,), by exact derivatives of the flow.

    Args:
        mapping: the map of the flow's stationary points.
        at: the Hopf point.
        values: the parameters there.
    """
    values_at = {name: column[0] for name, column in mapping.complete(values, 1).items()}
    hopf_point = values_at, at.at[0], at[0].modes
    J = np.asarray(linearised_flow(mapping)(*hopf_point)[1])
    eigenvalues = np.linalg.eigvals(J)
    upper = eigenvalues[np.imag(eigenvalues) > 0.0]
    eigenvalue, q, p = critical_eigenvectors(J, complex(upper[np.argmin(np.abs(np.real(upper)))]))
    a, b, frequency = np.real(q), np.imag(q), eigenvalue.imag

    def derivatives(*directions: tuple[Vector, Vector, Vector]) -> tuple[np.ndarray, np.ndarray]:
        """The second derivatives along two directions of each triple, and the third along all of them."""
        second, third = flow_derivatives(mapping)(*hopf_point, *np.swapaxes(directions, 0, 1))
        return np.asarray(second), np.asarray(third)

    (aa, bb, ab, *_), (aaa, bbb, abb, aab, *_) = derivatives(
        *((a, a, a), (b, b, b), (a, b, b), (b, a, a)), *[(a, a, a)] * 2
    )
    h11 = np.linalg.solve(-J, aa + bb)
    h20 = np.linalg.solve(2j * frequency * np.eye(len(J)) - J, aa - bb + 2j * ab)
    pairs = ((a, h11), (b, h11), (a, np.real(h20)), (b, np.imag(h20)), (a, np.imag(h20)), (b, np.real(h20)))
    (a_11, b_11, a_r, b_i, a_i, b_r), _ = derivatives(*((u, v, u) for u, v in pairs))
    cubic = aaa + abb + 1j * (aab + bbb) + 2.0 * (a_11 + 1j * b_11) + a_r + b_i + 1j * (a_i - b_r)
    return HopfForm(frequency, q, p, complex(p @ cubic) / 2.0, h11, h20)


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

    def linearised(change: float, x: Vector) -> tuple[Vector, Matrix]:
        """The rates and their Jacobian at x, with the parameter changed."""
        rates, jacobian = program({**values_at, parameter: value + change}, x, modes)
        return np.asarray(rates), np.asarray(jacobian)

    step = PARAMETER_STEP * (1.0 + abs(value))
    by_parameter = (linearised(step, x)[0] - linearised(-step, x)[0]) / (2.0 * step)
    branch = np.linalg.solve(-linearised(0.0, x)[1], by_parameter)
    ahead, behind = (linearised(d, x + d * branch)[1] for d in (step, -step))
    # the derivative of the critical eigenvalue along the branch of stationary points
    eigenvalue_rate = complex(form.p @ (ahead - behind) @ form.q) / (2.0 * step)
    radius = amplitude / np.max(np.abs(form.q)) / 2.0
    change = -form.cubic.real * radius**2 / eigenvalue_rate.real
    frequency = form.frequency + eigenvalue_rate.imag * change + form.cubic.imag * radius**2
    phase = 2.0 * np.pi * np.arange(count) / count
    z = radius * np.exp(1j * phase)[:, None]
    points = (
        x + change * branch + 2.0 * (z * form.q).real + np.abs(z) ** 2 * form.h11 + (z**2 * form.h20).real
    )
    columns = {quantity.name: points[:, k] for k, quantity in enumerate(mapping.coordinates)}
    period = 2.0 * np.pi / frequency
    return pd.DataFrame({"time": phase / frequency, **columns, parameter: value + change, "period": period})
