"""Functions of `import gaitsweep as gs`, as listed in `gaitsweep/__init__.pyi`.

`sweep.py`: sweep, perturb, simulate; `run.py`: run; `result.py`: the result of a run, whose figures are those
of `figures_of_table.py`; `return_map.py`: return_map; `fixed_points.py`: stationary, and the searches and
branches of both; `atlas.py`: atlas; `quantifiers.py`: quantifiers; `fits.py`: search, sensitivity;
`simulator.py`: simulator; `joining.py`: concat, same_categories. `keywords.py` makes jobs of models and
keywords.
"""
