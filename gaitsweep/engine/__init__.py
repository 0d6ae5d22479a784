"""The engine: integration, events, recorders and sweeps, for every model.

`advance` makes one attempt of a trajectory, whose state is in `carry`; `trial_step` tries and checks its
step. `event_location`, `hidden_events`, `switches` and `step_control` are its parts; `solver` has its
methods, `numerics` its tolerances and steps. `recorders` select records and end rows; `sweep` runs rows in
lanes on `devices`, by XLA or by the programs of `kernel`. `poincare` has return maps and their derivatives,
`tangents` derivatives along a trajectory, `flow_spectrum` the eigenvalues of a flow. `leaves` has the arrays
of a state, `model_shapes` their shapes, `dependences` what results depend on, `all_variables` the coordinates
of a model without a chart; `pushed_model` adds pushes to a model. `content` caches programs by the content of
models (`content_reader`), and `stored_traces` keeps them on disk.
"""
