"""Fitting of a model's constants: searches, and the sensitivity of results to each constant."""
