"""Attractors, their basins, and the edge states between basins.

`attractors` groups settled states in the distances of `state_space`: by clusters, or by sampled sets where
they have no period. `attractor_matching` follows attractors along a parameter. `grid` and `fractions` count
starts. `measures`, `basin_boundaries` and `quantifiers` measure basins, `edge_states` searches saddles in
their boundaries.
"""
