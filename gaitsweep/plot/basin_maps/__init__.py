"""Figures of basins of attraction.

`basin_heat_map.py`: basin (a map over any two swept quantities), recovery, shock; `basin_measures.py`:
basin_measures; `gait_map.py`: gait_map, the gaits at each point of a plane of two parameters. `cells.py` has
the cells of a grid of starts.
"""
