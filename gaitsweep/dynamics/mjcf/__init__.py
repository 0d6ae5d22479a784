"""MJCF files of models.

`source` compiles a file, `of_mjcf` is the base of models (`BodyModel` in `body`, `MjcfModel` in `mjx`),
`drawing` draws a body.
"""
