"""The engine: integration, events, recorders and sweeps, for every model.

`advance` makes one attempt of a trajectory, whose state is in `carry`, by a `trial` step; `event_location`,
`hidden_events`, `event_stall`, `switches` and `step_control` are its parts, `solver` has its methods,
`numerics` its tolerances and steps. `recorders` select records and end rows; `sweep` runs rows in lanes on
`devices`, by XLA or by the programs of `kernel`. `poincare` has return maps and their derivatives.
"""
