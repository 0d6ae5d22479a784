"""The observables and the signals of the quadruped."""

from __future__ import annotations

from gaitsweep.contract import Quantity
from gaitsweep.models.waist_quadruped.mechanics import LIMBS


def _difference(i: int, j: int) -> Quantity:
    return Quantity(
        f"delta_{i}{j}", "rad", f"lead of limb {i} over limb {j} at limb 3's landing",
        circular=True, symbol=rf"\Delta_{{{i}{j}}}", source="eq. (5)",
    )  # fmt: skip


OBSERVABLES = (
    _difference(1, 3),
    _difference(1, 2),
    _difference(3, 4),
    Quantity("speed", "m/s", "mean forward speed over the last cycle", symbol="v"),
    Quantity("period", "s", "duration of the last cycle", symbol="T"),
)
SIGNALS = (
    *(Quantity(f"phase_{i + 1}", "rad", f"phase phi_{i + 1} of limb {i + 1}", circular=True) for i in LIMBS),
    *(Quantity(f"contact_{i + 1}", "1", f"1 while foot {i + 1} is on the ground") for i in LIMBS),
    Quantity("waist", "rad", "angle of the waist joint", symbol=r"\theta_w"),
    Quantity("roll", "rad", "roll of the front body, for small angles"),
    Quantity("pitch", "rad", "pitch of the front body, for small angles"),
    *(Quantity(f"q_{i}", "m, 1 or rad", f"position {i} of the tree, as MuJoCo's qpos") for i in range(16)),
)
