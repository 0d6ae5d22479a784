"""The papers whose models, figures and claims come with gaitsweep, each an extension like any other."""

from __future__ import annotations

from gaitsweep.shipped import shipped

JOBS, CONFIGS, CLAIMS = shipped("sweeps"), shipped("configs"), shipped("configs/claims")
