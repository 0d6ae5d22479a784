"""Fitting of a model's constants: searches, and the sensitivity of results to each constant.

A search is read by `search_job.py` and run by `search.py`, with `optimisers.py`, `concurrent_batches.py`,
`targets.py` (misses, scores and conflicts), `robustness.py`, `identifiability.py` and `search_figures.py`;
`estimate.py` estimates its cost. A sensitivity analysis is read by `sensitivity_job.py` and run by
`sensitivity.py`, with the designs and indices of `sensitivity_methods.py`. Both measure sets of constants
(`free_parameters.py`, `fit_job.py`, `fit_fields.py`) by `population.py` and `condition_rows.py`, into a
directory (`fit_directory.py`); the measures are in `measure.py` (their base), `measure_fields.py`,
`row_measures.py`, `ramp_measures.py` and `fixed_point_measure.py`. `schema.py` describes both fields for
editors.
"""
