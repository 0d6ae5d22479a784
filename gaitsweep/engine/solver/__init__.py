"""The integration methods.

`methods` has them by name, with their limits and requirements on a model; `step` the form of one,
`runge_kutta`, `rosenbrock`, `taylor` and `exponential` their steps.
"""
