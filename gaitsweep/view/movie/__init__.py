"""Stick figures and movies of a row.

`animation.py` composes frames and poses of a drawing of the body, which is that of `side_view.py` or MuJoCo's
(`mujoco_movie.py`, with the program `mujoco_painter.py`); `movie_file.py` writes them as GIF or MP4.
"""
