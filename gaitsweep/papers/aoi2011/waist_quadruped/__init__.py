"""Quadruped with a passive waist joint (Aoi, Yamashita and Tsuchiya 2011).

`model.py` puts it together from its oscillators (`rhythm.py`), its limbs and the paths of its feet
(`kinematics.py`), its body (`parameters.py`, `mechanics.py`, `bodies.py`) and its fixed steps
(`semi_implicit.py`). `state.py` has its states and observables, `chart.py` the coordinates of its return map,
`drawing.py` its skeleton.
"""

from gaitsweep.papers.aoi2011.waist_quadruped.model import WaistQuadruped as WaistQuadruped
