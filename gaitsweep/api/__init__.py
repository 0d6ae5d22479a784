"""Functions of `import gaitsweep as gs`, as listed in `gaitsweep/__init__.pyi`.

`trajectories.py`: sweep, perturb, simulate; `result.py`: run, and the result of a run, whose figures are
those of `figures_of_table.py`; `maps.py`: return_map; `stationary.py`: stationary; `atlas.py`: atlas;
`quantifiers.py`: quantifiers; `fits.py`: search, sensitivity. `keywords.py` makes jobs of models and
keywords.
"""
