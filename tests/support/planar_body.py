"""Bodies in a vertical plane without actuators, as an MJCF gives them."""

from __future__ import annotations

from typing import Any

import numpy as np

import gaitsweep as gs


def planar_body(xml: str) -> type[gs.BodyModel]:
    """The class of a body of this MJCF, whose second coordinate is its height; its period is 1 s."""

    class Body(gs.BodyModel):
        """A body in a vertical plane."""

        body_file = xml

        def control(self, p: Any, s: Any) -> Any:
            return np.zeros(0)

        @gs.observable("m", "height", scale=0.1)
        def height(self, p: Any, s: Any) -> Any:
            return s.q[1]

        def period(self, p: Any) -> Any:
            return 1.0

    return Body
