"""Poincare maps: returns to the section, with their derivatives.

`poincare_return` is one return, `maps` an abstract map of batches of points, `map_derivatives` its images by
compiled programs; `return_map` and `stationary_map` are its forms, by `model_map`.
"""
