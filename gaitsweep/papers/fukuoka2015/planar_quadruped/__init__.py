"""Planar quadruped with leg-loading feedback (Fukuoka, Habu and Fukui 2015)."""

from gaitsweep.papers.fukuoka2015.planar_quadruped.model import PlanarQuadruped

__all__ = ["PlanarQuadruped"]
