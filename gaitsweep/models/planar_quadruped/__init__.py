"""Planar quadruped with leg-loading feedback (Fukuoka, Habu and Fukui 2015)."""

from gaitsweep.models.planar_quadruped.model import PlanarQuadruped

__all__ = ["PlanarQuadruped"]
