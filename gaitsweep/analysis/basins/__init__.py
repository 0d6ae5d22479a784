"""Attractors, their basins, and the edge states between basins.

`attractors` groups settled states by `single_linkage` of the distances in `state_space`, and `sampled_sets`
those without a period; `attractor_matching` follows attractors along a parameter. `grid` and `fractions`
count starts. `measures`, `fractal_boundaries`, `wada` and `quantifiers` measure basins, `edge_states`
searches their boundaries with `edge_mappers`, and `line_corners` splits attractors that are lines.
"""
