"""Analyses of tables and models: gaits, and the theory behind them.

`basins` has attractors and their basins, `transitions` hysteresis and jumps between gaits, `continuation`
fixed points of maps and their branches, `atlas` all gaits of a model. `falls` has mean steps to a fall from
tables, `rare_falls` those of a model by importance sampling, `phase_response` the phase that a push gains,
`records` what all read of tables: columns, axes, outcomes of rows.
"""
