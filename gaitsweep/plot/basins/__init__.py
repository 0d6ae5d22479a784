"""Figures of basins of attraction.

`basin.py`: basin; `basin_measures.py`: basin_measures; `gait_map.py`: gait_map; `shocks.py`: recovery, shock.
`cells.py` has the cells of a grid of starts.
"""
