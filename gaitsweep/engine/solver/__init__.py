"""The integration methods.

`methods` has them by name, with their limits and requirements on a model (`engine/numerics.py` chooses
one); `runge_kutta`, `rosenbrock`, `taylor` (by the `recurrences` of operations) and `exponential` their
steps.
"""
