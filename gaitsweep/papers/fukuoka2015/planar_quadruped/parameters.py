"""Parameters and initial conditions of the planar quadruped.

The paper's values are in a supplement. Here are those that later papers quote; the others come from a search.
`configs/fukuoka2015.yaml` has the set.
"""

from __future__ import annotations

from gaitsweep.contract import Quantity
from gaitsweep.papers.fukuoka2015.planar_quadruped.nine_gaits import THRESHOLD

_PAPER = "Fukuoka 2015"
_SUPPLEMENT = "Fukuoka 2015, supplement"
_SEARCH = "found by search"
_PATH = "path over sigma: the supplement at 0.5, its ends by search"


def _positive(
    name: str, unit: str, meaning: str, default: float | str, symbol: str, source: str = _SEARCH
) -> Quantity:
    return Quantity.positive(name, unit, meaning, default, symbol, source)


def _at_least_0(
    name: str, unit: str, meaning: str, default: float | str, symbol: str, source: str = _SEARCH
) -> Quantity:
    return Quantity(name, unit, meaning, default, low=0.0, symbol=symbol, source=source)


def _along_path(
    name: str,
    unit: str,
    meaning: str,
    start: float,
    middle: float,
    end: float,
    symbol: str,
    *,
    positive: bool,
) -> tuple[Quantity, ...]:
    """A speed parameter, linear between sigma = 0, 0.5 and 1, and its values at the two ends of the path."""
    formula = f"{start:g}"
    for slope, along in ((middle - start, "min(sigma, 0.5)"), (end - middle, "max(sigma - 0.5, 0)")):
        formula += f" {'-' if slope < 0.0 else '+'} {abs(2.0 * slope):.6g}*{along}"
    # other ends are added to the path between the default ones, which changes no bit of those
    formula += f" + ({name}_slow - {start:.6g})*max(1 - 2*sigma, 0)".replace("- -", "+ ")
    formula += f" + ({name}_fast - {end:.6g})*max(2*sigma - 1, 0)".replace("- -", "+ ")
    low = {"low": 0.0, "open_ends": True} if positive else {}
    return (
        Quantity(f"{name}_slow", unit, f"{meaning} at the slow end of the path", start,
                 symbol=f"{symbol}(0)", source=_SEARCH, **low),
        Quantity(f"{name}_fast", unit, f"{meaning} at the fast end of the path", end,
                 symbol=f"{symbol}(1)", source=_SEARCH, **low),
        Quantity(name, unit, meaning, formula, symbol=symbol, source=_PATH, **low),
    )  # fmt: skip


_SPEED = (
    Quantity("sigma", "1", "place on the path of speed, slow to fast", 0.5, low=0.0, high=1.0,
             symbol=r"\sigma", source=_SEARCH),
    Quantity("v_d", "m/s", "desired speed", 1.0,
             symbol="v_d"),
    *_along_path("s", "1", "tonic drive", 1.18, 1.71, 1.40, "s", positive=True),
    *_along_path("Tr", "s", "time constant of the rise", 0.085, 0.0473, 0.0206, "T_r", positive=True),
    *_along_path("theta_st", "rad", "target hip angle in stance", -0.166, -0.438, -1.0,
                 r"\theta_\mathrm{st}", positive=False),
    *_along_path("Kp_hip_st", "N m/rad", "stiffness of a hip in stance", 5.0, 8.13, 10.6,
                 r"K_p^\mathrm{hip,st}", positive=True),
    *_along_path("Kp_knee_st", "N/m", "stiffness of a knee in stance", 2840.0, 1970.0, 1820.0,
                 r"K_p^\mathrm{knee,st}", positive=True),
    *_along_path("l_sw", "m", "target knee length in swing", 0.065, 0.057, 0.054,
                 r"l_\mathrm{sw}", positive=False),
    *_along_path("Kp_knee_sw", "N/m", "stiffness of a knee in swing", 2130.0, 1860.0, 2740.0,
                 r"K_p^\mathrm{knee,sw}", positive=True),
)  # fmt: skip

_NETWORK = (
    Quantity("k1", "1/rad", "feedback of the hip's angle to both half-centres", 3.0, symbol="k_1",
             source=_SUPPLEMENT),
    Quantity("k2", "1/N", "feedback of the load to the flexor; 0: none", 0.08, symbol="k_2",
             source="Fukuoka 2015, eq. (1); value by search"),
    _positive("Ta", "s", "time constant of the adaptation", 0.6, "T_a", _SUPPLEMENT),
    _at_least_0("b", "1", "gain of the inhibition by fatigue", 3.0, "b", _SUPPLEMENT),
    Quantity("alpha", "1", "weight between left and right leg", -0.3, symbol=r"\alpha", source=_SUPPLEMENT),
    Quantity("beta_w", "1", "weight between fore and hind leg of a side", -0.8, symbol=r"\beta",
             source=_SUPPLEMENT),
    Quantity("gamma", "1", "weight between a leg's half-centres", -2.0, symbol=r"\gamma",
             source=_SUPPLEMENT),
    Quantity("theta0", "rad", "hip angle of zero feedback", -0.262, symbol=r"\theta_0",
             source=_SUPPLEMENT),
)  # fmt: skip

_MOTORS = (
    Quantity("theta_sw", "rad", "target hip angle in swing, forward positive", 1.312,
             symbol=r"\theta_\mathrm{sw}", source=_SUPPLEMENT),
    _positive("Kp_hip_sw", "N m/rad", "stiffness of a hip in swing", 7.6, r"K_p^\mathrm{hip,sw}",
              _SUPPLEMENT),
    Quantity("l_st", "m", "target knee length in stance", 0.130, symbol=r"l_\mathrm{st}",
             source=_SUPPLEMENT),
    _at_least_0("Kv_hip", "N m s/rad", "damping of the hips", 1.0, r"K_v^\mathrm{hip}", _SUPPLEMENT),
    _at_least_0("Kv_knee", "N s/m", "damping of the knees", 40.0, r"K_v^\mathrm{knee}", _SUPPLEMENT),
    _at_least_0("Kv_knee_sw", "N s/m", "damping of a knee in swing", "Kv_knee", r"K_v^\mathrm{knee,sw}",
                _SUPPLEMENT),
    _at_least_0("Kv_knee_st", "N s/m", "damping of a knee in stance", "Kv_knee", r"K_v^\mathrm{knee,st}",
                _SUPPLEMENT),
)  # fmt: skip

BODY = (
    Quantity("com_x", "m", "torso's centre of mass ahead of the middle between the hips", 0.040,
             symbol=r"x_\mathrm{com}", source=_SEARCH),
    Quantity("com_z", "m", "torso's centre of mass above the hips", 0.0, symbol=r"z_\mathrm{com}",
             source=_SEARCH),
    _positive("torso_mass", "kg", "mass of the torso", 4.0, "m_T", _PAPER),
    _positive("torso_inertia", "kg m2", "inertia of the torso in pitch about its centre of mass",
              "torso_mass*(0.67**2 + 0.1**2)/12", "I_T", "a uniform box, 0.67 m long and 0.1 m high"),
    _positive("upper_mass", "kg", "mass of an upper leg", 0.5, "m_U", _PAPER),
    _positive("lower_mass", "kg", "mass of a lower leg without its foot", 0.2, "m_L", _PAPER),
    _positive("foot_mass", "kg", "mass of a foot", 0.05, "m_F", _PAPER),
    _positive("hip_x", "m", "hips ahead of and behind their middle", 0.28, r"x_\mathrm{hip}"),
    _positive("l_0", "m", "distance from hip to sole at knee length 0", 0.175, "l_0"),
    _positive("upper_length", "m", "length of an upper leg without its round ends", 0.15, "l_U"),
    _positive("lower_length", "m", "length of a lower leg without its round ends", 0.13, "l_L"),
    _positive("foot_radius", "m", "radius of a foot", 0.025, "r_F"),
)  # fmt: skip

_GROUND = (
    _positive("g", "m/s2", "gravitational acceleration", 9.81, "g", _PAPER),
    _at_least_0("mu", "1", "friction between foot and ground", 1.0, r"\mu"),
    _positive("K_foot", "N/m", "spring under a foot (body: tree)", 8.0e4, "K_F"),
    _at_least_0("D_foot", "N s/m", "damper under a foot (body: tree)", 250.0, "D_F"),
    _positive("v_slip", "m/s", "slip speed of full friction (body: tree)", 0.01,
              r"v_\mathrm{slip}"),
)  # fmt: skip

_READING = (
    Quantity("threshold", "1", "largest shift of a pair that counts as zero, cycles", THRESHOLD, low=0.0,
             high=0.5, symbol=r"\delta_0", source=_SEARCH),
    Quantity("memory", "1", "cycles over which shifts are averaged", 10.0, low=1.0, symbol="n"),
)  # fmt: skip

PARAMETERS = (*_SPEED, *_NETWORK, *_MOTORS, *BODY, *_GROUND, *_READING)

STARTS = (
    Quantity("seed", "1", "number of the perturbation", 0.0, low=0.0, high=2.0**31, whole=True),
    Quantity("scatter", "1", "size of the perturbation: largest change of a potential", 0.1, low=0.0),
    Quantity("pair", "1", "0: RF and LH swing first; 1: LF and RH", 0.0, low=0.0, high=1.0, whole=True),
)  # fmt: skip
