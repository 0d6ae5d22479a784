"""Fixed points of maps: Newton's method, multipliers, bifurcations, and continuation along a parameter.

`newton` finds fixed points and `floquet_multipliers` their stability. `arclength_step` makes one step along
branches, `branch_follower` chooses the lengths of the steps and follows branches to their ends,
`branch_points` crosses to other branches, and `continuation` does all this for a table. `bifurcation_tests`
finds bifurcations between two points, `critical_points` locates them, `normal_forms` has their coefficients,
and the cycles that begin at Hopf points. `bifurcation_curves` follows them in two
parameters. `one_sided` is for maps with corners, `plain_map` for functions, `lockstep` for batches of
evaluations; `branch_table` and `stable_ranges` have the results.
"""
