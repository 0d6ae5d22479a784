"""Figures of basins of attraction.

`basin.py`: basin, recovery, shock; `basin_measures.py`: basin_measures; `gait_map.py`: gait_map.
`cells.py` has the cells of a grid of starts.
"""
