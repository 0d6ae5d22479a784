"""Attractors, their basins, and the edge states between basins.

`attractors` groups settled states in the distances of `state_space`: by clusters, or by sampled sets where
they have no period. `attractor_matching` follows attractors along a parameter. `grid` and `fractions` count
starts. `basin_boundaries` has the entropy, the uncertainty exponent and the Wada property of boundaries,
`measures` all measures of a table, `quantifiers` those of attractors along a parameter, and `edge_states`
searches saddles in boundaries.
"""
