"""Articulated trees: kinematics, dynamics and energy of bodies joined by hinges and slides."""

from __future__ import annotations

from gaitsweep.lazy_imports import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
