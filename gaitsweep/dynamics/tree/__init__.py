"""Articulated trees: kinematics and dynamics of bodies joined by hinges and slides.

`articulated_tree` has the structure, which `from_mjcf` reads; `kinematics` has places and velocities of
links, `dynamics` their accelerations, `spatial` the vectors and inertias of both.
"""

from __future__ import annotations

from gaitsweep.lazy_imports import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
