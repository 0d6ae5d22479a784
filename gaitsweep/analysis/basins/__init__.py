"""Attractors, their basins, and the edge states between basins.

`attractors` groups settled states in the distances of `state_space`: by `state_clusters`, or by
`sampled_sets` where they have no period. `attractor_matching` follows attractors along a parameter. `grid`
and `fractions` count starts. `measures`, `fractal_boundaries`, `wada` and `quantifiers` measure basins,
`edge_states` searches their boundaries with `edge_mappers`.
"""
