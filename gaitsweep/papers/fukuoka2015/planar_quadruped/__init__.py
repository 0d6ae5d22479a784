"""Planar quadruped with leg-loading feedback (Fukuoka, Habu and Fukui 2015).

`model.py` puts it together from its network and motors (`rhythm.py`), its body (`mechanics.py`, `bodies.py`),
and the running measurement of its cycles (`cycle.py`), by which `nine_gaits.py` names its gaits.
`parameters.py` has its parameters and `state.py` its states, `observables.py` what is read at the section,
with the cost of transport, and the signals, `drawing.py` its skeleton.
"""

from gaitsweep.papers.fukuoka2015.planar_quadruped.model import PlanarQuadruped as PlanarQuadruped
