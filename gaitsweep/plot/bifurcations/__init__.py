"""Figures of what happens along a parameter: maps, branches of fixed points, jumps of slow passes.

`return_map.py`: one value over the last; `cycles.py`: values over the crossings; `branches.py`: fixed
points of such maps; `continuation.py` (continuation, stable_ranges, and the
drawing of branches): branches; `atlas.py`: atlas, road_map, orbit_family; `hysteresis.py`:
hysteresis, with `passes.py` (its panels and passes); `gait_transitions.py` and
`bifurcation_diagram.py` (orbit): settled rows.
"""
