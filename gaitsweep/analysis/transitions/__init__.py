"""Hysteresis, return maps and transitions between gaits.

`jumps` finds the jumps of ramps and staircases, and `hysteresis` has the transition points and loops of both
directions. `return_map` has the first return map of an observable, its fixed points and ghosts, from the
`drift` of its points and its zeros; `smoothing` fits the drift between breaks.
"""
