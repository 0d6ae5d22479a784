"""Models by declaration, and the mechanics and oscillators that models share.

`declared_model` is the class of models with a flow, `map_model` that of maps; `declarations` and
`event_declarations` are what they declare, `declaration_faults` refuses wrong ones, `declared` is what is
built from them, `section_coordinates` the coordinates of return maps. `gaits_by_footfalls` has the touchdowns
of feet, and names gaits by them (walk, trot, pace, bound); `sliding`, `noise`, `random_numbers`, `ground`,
`compliant_foot` and `matsuoka` are other parts of models. `single_precision` evaluates a model in float32.
`body` is a body of an MJCF with located contacts, on an articulated `tree`; `mjx` one that MuJoCo steps;
`mjcf` reads the file, `mjcf_drawing` draws it; `controllers` move its legs.
"""

from __future__ import annotations

from gaitsweep.lazy_imports import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
