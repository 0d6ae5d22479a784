"""The integration methods.

`methods` has them by name, with their limits and requirements on a model; `runge_kutta`, `rosenbrock`,
`taylor` (by the `recurrences` of operations) and `exponential` their steps.
"""
