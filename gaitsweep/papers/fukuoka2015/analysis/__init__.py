"""Gaits from swing onsets, loads and tilt.

`swing_onsets.py` finds the onsets in a table; `gaits_of_onsets.py` names the gait of each row by them, and
`gait_tables.py` that of each row of any table; `gait_bouts.py` follows gaits along a row; `gait_summaries.py`
summarises them; `body_oscillation.py`, `pair_loads.py` and `loading_rule.py` relate them to pitch and loads.
"""
