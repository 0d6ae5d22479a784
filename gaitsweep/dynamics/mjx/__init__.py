"""Bodies of an MJCF that MuJoCo steps: in C on CPUs, by MJX on GPUs.

`mjcf_model` is the class of their models, `mjx_body` a body stepped by MJX and `c_body` one stepped in C.
`corrections` has functions of MuJoCo C that replace those of MJX, `refusals` the features that MJX lacks,
`variants` bodies whose masses and lengths vary, and `against_c` a comparison with MuJoCo C.
"""

from __future__ import annotations

from gaitsweep.lazy_imports import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
