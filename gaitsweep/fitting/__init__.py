"""Fitting of a model's constants: searches, and the sensitivity of results to each constant.

A search is read by `search_job.py` and run by `search.py`, with `optimisers.py`, `targets.py` (misses, scores
and conflicts), `robustness.py` and `identifiability.py`; `search_cost.py` estimates its cost. A sensitivity
analysis is read by `sensitivity_job.py` and run by `sensitivity.py`, with the designs and indices of
`sensitivity_methods.py`. `figures.py` draws both. `search_and_sensitivity_job.py` is the common part of both
jobs, which measure sets of constants (`free_parameters.py`, `fit_fields.py`) by `population.py`, into a
directory (`fit_directory.py`); the measures are in `measure.py` (their base and fields), `row_measures.py`
and `ramp_measures.py`. `schema.py` describes both fields for editors.
"""
