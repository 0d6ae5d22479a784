"""Quadruped with a passive waist joint (Aoi, Yamashita and Tsuchiya 2011)."""

from gaitsweep.models.waist_quadruped.model import WaistQuadruped

__all__ = ["WaistQuadruped"]
