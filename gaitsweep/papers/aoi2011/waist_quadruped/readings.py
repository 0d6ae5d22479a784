"""The observables at the section, limb 3's landing, and the signals of a trace."""

from __future__ import annotations

import math

from jaxtyping import Array, Float

from gaitsweep.contract import Quantity
from gaitsweep.dynamics import wrapped
from gaitsweep.papers.aoi2011.waist_quadruped.posture import WAIST, tilt
from gaitsweep.papers.aoi2011.waist_quadruped.sizes import LIMBS
from gaitsweep.papers.aoi2011.waist_quadruped.state import State


def _difference(i: int, j: int) -> Quantity:
    return Quantity(
        f"delta_{i}{j}", "rad", f"lead of limb {i} over limb {j} at limb 3's landing",
        circular=True, symbol=rf"\Delta_{{{i}{j}}}", source="eq. (5)",
    )  # fmt: skip


# The infinite scales: a row settles or not by its phases, speed and period, whatever its feet do meanwhile.
OBSERVABLES = (
    _difference(1, 3),
    _difference(1, 2),
    _difference(3, 4),
    Quantity("speed", "m/s", "mean speed along x, the first direction, in the last cycle", symbol="v"),
    Quantity("period", "s", "duration of the last cycle", symbol="T"),
    Quantity("stride", "m", "distance along x in the last cycle", symbol="S", source="eq. (3)",
             scale=math.inf),
    *(
        Quantity(f"duty_{i + 1}", "1", f"share of the last cycle with foot {i + 1} on the ground",
                 symbol=rf"\beta_{i + 1}", source="eq. (3)", scale=math.inf)
        for i in LIMBS
    ),
    *(
        Quantity(f"touchdowns_{i + 1}", "1", f"touchdowns of foot {i + 1} in the last cycle",
                 symbol=f"n_{i + 1}", scale=math.inf)
        for i in LIMBS
    ),
)  # fmt: skip
SIGNALS = (
    *(
        Quantity(f"phase_{i + 1}", "rad", f"phase of limb {i + 1}", circular=True, symbol=rf"\phi_{i + 1}")
        for i in LIMBS
    ),
    *(Quantity(f"contact_{i + 1}", "1", f"1 while foot {i + 1} is on the ground") for i in LIMBS),
    Quantity("waist", "rad", "angle of the waist joint", symbol=r"\theta_w"),
    Quantity("roll", "rad", "roll of the front body, for small angles"),
    Quantity("pitch", "rad", "pitch of the front body, for small angles"),
    *(Quantity(f"q_{i}", "m, 1 or rad", f"position {i} of the tree, as MuJoCo's qpos") for i in range(16)),
)


def observed(state: State) -> dict[str, Float[Array, ""]]:
    """The observables of a state at limb 3's landing."""
    phi = state.phi
    return {
        "delta_13": wrapped(phi[0] - phi[2]),  # eq. (5)
        "delta_12": wrapped(phi[0] - phi[1]),
        "delta_34": wrapped(phi[2] - phi[3]),
        "speed": state.speed,
        "period": state.period,
        "stride": state.speed * state.period,
        **{f"duty_{i + 1}": state.duty[i] for i in LIMBS},
        **{f"touchdowns_{i + 1}": state.touchdowns[i] for i in LIMBS},
    }


def signalled(state: State) -> dict[str, Float[Array, ""]]:
    """The signals of a state."""
    s = state
    contact = state.contact.astype(state.phi.dtype)
    roll, pitch = tilt(s.q)
    return {
        **{f"phase_{i + 1}": wrapped(s.phi)[i] for i in LIMBS},
        **{f"contact_{i + 1}": contact[i] for i in LIMBS},
        "waist": s.q[WAIST],
        "roll": roll,
        "pitch": pitch,
        **{f"q_{i}": s.q[i] for i in range(16)},
    }
