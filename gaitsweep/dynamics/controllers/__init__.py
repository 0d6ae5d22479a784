"""Controllers of legs that a model file declares: oscillators, their feedback, and targets of joints.

`model_file` reads the file, whose field `controller` is a `Controller`. `oscillators` has the kinds of
oscillators and the interface of a kind, `leg_targets` the targets of joints or feet and the actuators that
follow them, and `controlled_body` the class of the model. A body that Python code controls overrides
`control` of `gaitsweep.BodyModel` or `gaitsweep.MjcfModel` instead.
"""
