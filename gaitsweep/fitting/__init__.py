"""Fitting a model's constants: a search over them, and how much results depend on each of them."""
