"""Planar quadruped with leg-loading feedback (Fukuoka, Habu and Fukui 2015).

`model.py` puts it together from its network and motors (`rhythm.py`), its body (`mechanics.py`, `bodies.py`),
and the running measurement of its cycles (`cycle.py`), by which `nine_gaits.py` names its gaits.
`observables.py` has what is read at the section, with the cost of transport, and the signals.
"""

from gaitsweep.papers.fukuoka2015.planar_quadruped.model import PlanarQuadruped as PlanarQuadruped
