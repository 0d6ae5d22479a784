"""Ambe et al. 2021: a chain of legs with phase resetting, its theory, its waves and basins."""

from gaitsweep.extension import Extension
from gaitsweep.shipped import shipped

extension = Extension(
    models={
        "multilegged": "gaitsweep.models.multilegged.model:Multilegged",
        "multilegged_reduced": "gaitsweep.models.multilegged.reduced:MultileggedReduced",
    },
    figures=(
        *(f"gaitsweep.plot.chain.{name}" for name in ("drift_law", "gait_shares", "solution_set")),
        *(f"gaitsweep.plot.chain.{name}" for name in ("source_place", "theory", "wave_speed")),
    ),
    analyses=("gaitsweep.papers.ambe2021.analyses",),
    measures=(
        "gaitsweep.claims.measures.ambe2021_equations",
        "gaitsweep.claims.measures.ambe2021_simulation",
        "gaitsweep.claims.measures.ambe2021_theory",
    ),
    jobs=shipped("sweeps"),
    configs=shipped("configs"),
    claims=shipped("configs/claims"),
)
