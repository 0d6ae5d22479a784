"""The papers whose models, figures and claims come with gaitsweep, each an extension like any other."""

from __future__ import annotations

from gaitsweep.shipped import shipped

FOLDERS = {"jobs": shipped("sweeps"), "configs": shipped("configs"), "claims": shipped("configs/claims")}
