"""Aoi et al. 2011: a quadruped with a passive waist joint, and the hysteresis of its gaits."""

from gaitsweep.extension import Extension
from gaitsweep.shipped import shipped

extension = Extension(
    models={"waist_quadruped": "gaitsweep.papers.aoi2011.waist_quadruped:WaistQuadruped"},
    measures=("gaitsweep.papers.aoi2011.measures",),
    jobs=shipped("sweeps"),
    configs=shipped("configs"),
    claims=shipped("configs/claims"),
)
