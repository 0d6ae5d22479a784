"""The engine: integration, events, recorders and sweeps, for every model.

`advance` makes one attempt of a trajectory, whose state is in `carry`; `trial_step` tries and checks its
step. `event_location`, `hidden_events` and `switches` are its parts; `solver` has its methods; `numerics`
chooses one, its tolerances and its steps. Endless chains of events halt in `advance`. `recorders` select
records and end rows; `sweep` runs rows in lanes on `devices`, by XLA or by the programs of `kernel`.
`poincare` has return maps and their derivatives, `tangents` derivatives along a trajectory, in all
coordinates of a model without a chart, `flow_spectrum` the eigenvalues of a flow. `leaves` has the arrays
of a state, `stored_traces` their shapes and what results depend on; `pushed_model` adds pushes to a model.
`content` caches programs by the content of models; the folder of compiled programs is
`gaitsweep/cache_folder.py`.
"""
