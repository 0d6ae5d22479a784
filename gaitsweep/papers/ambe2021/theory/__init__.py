"""The analytic theory of the multi-legged chain (Ambe 2021, sec. 3): `gs.analyses.multilegged_theory`."""

from __future__ import annotations

from gaitsweep.papers.ambe2021.theory.chain import Chain, lag, touchdown_phase, wave_speed, wavelength
from gaitsweep.papers.ambe2021.theory.gaits import distances
from gaitsweep.papers.ambe2021.theory.line_drift import drift, worst_case_cycles
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch
from gaitsweep.papers.ambe2021.theory.stability import characteristic_polynomial, linear_map, multipliers

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
