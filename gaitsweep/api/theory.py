"""The analytic theory of the multi-legged chain (Ambe et al. 2021, sec. 3): `gs.theory.Chain()`."""

from __future__ import annotations

from gaitsweep.models.multilegged.theory.chain import Chain, lag, touchdown_phase, wave_speed, wavelength
from gaitsweep.models.multilegged.theory.conserved import drift, worst_case_cycles
from gaitsweep.models.multilegged.theory.gaits import distances
from gaitsweep.models.multilegged.theory.solution_sets import Branch
from gaitsweep.models.multilegged.theory.stability import characteristic_polynomial, linear_map, multipliers

__all__ = [
    "Branch",
    "Chain",
    "characteristic_polynomial",
    "distances",
    "drift",
    "lag",
    "linear_map",
    "multipliers",
    "touchdown_phase",
    "wave_speed",
    "wavelength",
    "worst_case_cycles",
]
