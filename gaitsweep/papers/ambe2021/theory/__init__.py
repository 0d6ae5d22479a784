"""The analytic theory of the multi-legged chain (Ambe 2021, sec. 3): `gs.analyses.multilegged_theory`.

`chain.py` has the parameters and what follows from the force balance alone; `solution_sets.py` the periodic
solutions and the drift along them, `order.py` their touchdown orders and eigenvalues,
`conditions.py` their existence, and `gaits.py` the gait of a state by the nearest solution.
"""

from __future__ import annotations

from gaitsweep.papers.ambe2021.theory.chain import Chain, lag, touchdown_phase, wave_speed, wavelength
from gaitsweep.papers.ambe2021.theory.gaits import distances
from gaitsweep.papers.ambe2021.theory.order import characteristic_polynomial, linear_map, multipliers
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch, drift, worst_case_cycles

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
