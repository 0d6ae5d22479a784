"""Pages and movies of a result directory: explorer, report, animations.

`explorer/` writes the page of `gaitsweep explore`, `report.py` that of `gaitsweep report`, and `row_movie.py`
the movies and poses of `gaitsweep animate`, with `row_motion.py` (the motion of a row) and `movie/` (its
drawing).
"""
