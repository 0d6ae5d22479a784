"""The analytic theory of the multi-legged chain (Ambe 2021, sec. 3): `gs.analyses.multilegged_theory`.

`chain.py` has the parameters and what follows from the force balance alone; `solution_sets.py` the periodic
solutions and the drift along them, `order.py` their touchdown orders and eigenvalues,
`conditions.py` their existence, and `gaits.py` the gait of a state by the nearest solution.
"""

from gaitsweep.papers.ambe2021.theory.chain import Chain as Chain
from gaitsweep.papers.ambe2021.theory.chain import lag as lag
from gaitsweep.papers.ambe2021.theory.chain import touchdown_phase as touchdown_phase
from gaitsweep.papers.ambe2021.theory.chain import wave_speed as wave_speed
from gaitsweep.papers.ambe2021.theory.chain import wavelength as wavelength
from gaitsweep.papers.ambe2021.theory.gaits import distances as distances
from gaitsweep.papers.ambe2021.theory.order import characteristic_polynomial as characteristic_polynomial
from gaitsweep.papers.ambe2021.theory.order import linear_map as linear_map
from gaitsweep.papers.ambe2021.theory.order import multipliers as multipliers
from gaitsweep.papers.ambe2021.theory.solution_sets import Branch as Branch
from gaitsweep.papers.ambe2021.theory.solution_sets import drift as drift
from gaitsweep.papers.ambe2021.theory.solution_sets import worst_case_cycles as worst_case_cycles
