"""Quadruped with a passive waist joint (Aoi, Yamashita and Tsuchiya 2011).

`model.py` puts it together from its oscillators (`rhythm.py`), the paths of its feet (`foot_path.py`), its
body (`sizes.py`, `posture.py`, `mechanics.py`, `bodies.py`) and its fixed steps (`semi_implicit.py`).
"""

from gaitsweep.papers.aoi2011.waist_quadruped.model import WaistQuadruped

__all__ = ["WaistQuadruped"]
