"""Figures of what happens along a parameter: maps, branches of fixed points, jumps of slow passes.

`return_map.py`, `cycles.py`, `branches.py`: maps; `continuation.py`, `stable_ranges.py`, `folds.py`:
branches; `atlas.py`: atlas, road_map, orbit_family; `hysteresis.py`: hysteresis, with `passes.py` (its panels
and passes) and `branch_names.py` (names beside branches); `gait_transitions.py` and `orbit.py`: settled rows.
`branch_lines.py` draws branches.
"""
