"""MJCF files of models: `source` compiles a file, `of_mjcf` is the base of models, `drawing` draws a body."""
