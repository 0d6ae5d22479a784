"""Attractors, their basins, and the edge states between basins.

`attractors` groups settled states by `state_clusters` in the distances of `state_space`: by single linkage,
at corners of lines, and by sampled sets where they have no period. `attractor_matching` follows attractors
along a parameter. `grid` and `fractions` count starts. `measures`, `fractal_boundaries`, `wada` and
`quantifiers` measure basins, `edge_states` searches their boundaries with `edge_mappers`.
"""
