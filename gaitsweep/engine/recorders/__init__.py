"""Recorders: they select the records of a trajectory and end its row with a status of `gaitsweep/status.py`.

`recorder` is the abstract one, with the tests of failure. `settle`, `perturb`, `staircase`, `states` and, of
runs that wait for no gait, `recordings` have the others, beside `bounds` and `exponents` of settling rows,
`orbit_period` of periodic ones, and `parameter_schedules` of moving ones.
"""
