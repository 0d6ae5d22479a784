"""Quadruped with a passive waist joint (Aoi, Yamashita and Tsuchiya 2011)."""

from gaitsweep.papers.aoi2011.waist_quadruped.model import WaistQuadruped

__all__ = ["WaistQuadruped"]
