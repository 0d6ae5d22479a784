"""Gaits from swing onsets, loads and tilt.

`swing_onsets.py` finds the onsets in a table and names the gait of each row by them; `gait_tables.py` names
that of each row of any table and summarises them; `gait_bouts.py` follows gaits and the pitching of the body
along a row; `loading_rule.py` relates them to pitch and loads.
"""
