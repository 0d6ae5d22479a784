"""Fukuoka et al. 2015: a planar quadruped with Matsuoka oscillators and leg loading, and its nine gaits."""

from gaitsweep.extension import Extension
from gaitsweep.shipped import shipped

extension = Extension(
    models={"planar_quadruped": "gaitsweep.models.planar_quadruped:PlanarQuadruped"},
    figures=(
        *(f"gaitsweep.plot.gaits.{name}" for name in ("gait_ramp", "gait_series", "loading_rule")),
        *(f"gaitsweep.plot.gaits.{name}" for name in ("nine_gaits", "speed_gaits")),
    ),
    analyses=("gaitsweep.papers.fukuoka2015.analyses",),
    measures=("gaitsweep.claims.measures.fukuoka2015",),
    jobs=shipped("sweeps"),
    configs=shipped("configs"),
    claims=shipped("configs/claims"),
)
