"""Parameters of the quadruped, and the body of Table I scaled to the masses and lengths of a row.

`configs/aoi2011.yaml` has the paper's set of values. Values that the paper does not give are by search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from types import SimpleNamespace
from typing import Any

from gaitsweep.contract import Quantity
from gaitsweep.dynamics.tree import Geometry, Tree

LIMBS = range(4)
# The body of Table I, as in the MJCF.
BODY_SIZE = 0.1  # m: length and width of each body, and their distance
BODY_HEIGHT = 0.05  # m
HIP_X, HIP_Y = 0.048, 0.05  # m, from the centre of mass of a body
LINK_MASS, LINK_LENGTH = 0.1, 0.08  # kg, m
# What a body has of its own where its hips and its waist's axis are not level with the centres of mass.
HEIGHT_NAMES = ("front_height", "rear_height", "front_hip_z", "rear_hip_z", "waist_z")


def sizes_of(values: Mapping[str, Any]) -> SimpleNamespace:
    """A row's masses and lengths by name, as `factors` and `displacements` take them."""
    return SimpleNamespace(**{**dict.fromkeys(HEIGHT_NAMES), **values})


def factors(sizes: Any, stack: Callable[[list[Any]], Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The factors of mass and of size of each body and link relative to Table I, by name.

    Args:
        sizes: an object with `front_mass` (kg), `rear_length` (m) and so on, numbers or arrays; HEIGHT_NAMES
            are None in a level body.
        stack: the function that stacks them to an array.
    """

    def factor_of(length: Any, width: Any, height: Any) -> Any:
        level = [length / BODY_SIZE, width / BODY_SIZE]
        upwards = 1.0 if height is None else height / BODY_HEIGHT
        return stack([*level, upwards])

    front = factor_of(sizes.front_length, sizes.front_width, sizes.front_height)
    rear = factor_of(sizes.rear_length, sizes.rear_width, sizes.rear_height)
    links = [f"{part}_{i + 1}" for part in ("upper", "lower") for i in LIMBS]
    mass = {"front": sizes.front_mass, "rear": sizes.rear_mass}  # 1 kg each in Table I
    mass |= dict.fromkeys(links, sizes.link_mass / LINK_MASS)
    return mass, {"front": front, "rear": rear} | dict.fromkeys(links, sizes.link_length / LINK_LENGTH)


def displacements(sizes: Any, stack: Callable[[list[Any]], Any]) -> tuple[dict[str, Any], Any]:
    """Displacements (3,), m, of hips and waist, by link, and of the rear body's centre of mass.

    They are relative to the places that `factors` scales with the bodies, at which all are zero. The rear
    body's frame is at the waist, which is at the end of the front body.

    Args:
        sizes: as for `factors`, with `front_hip_x`, `body_distance` and so on.
        stack: the function that stacks them to an array (3,).
    """
    front_size, rear_size = sizes.front_length / BODY_SIZE, sizes.rear_length / BODY_SIZE
    front_width, rear_width = sizes.front_width / BODY_SIZE, sizes.rear_width / BODY_SIZE
    half = 0.5 * BODY_SIZE
    gap = half * front_size + half * rear_size - sizes.body_distance
    front = sizes.front_hip_x - HIP_X * front_size, sizes.front_hip_y - HIP_Y * front_width
    rear = gap + (HIP_X * rear_size - sizes.rear_hip_x), sizes.rear_hip_y - HIP_Y * rear_width
    if sizes.waist_z is None:  # a level body
        front_z, rear_z, axis = 0.0, 0.0, 0.0
        moved = {}
    else:
        front_z, rear_z, axis = sizes.front_hip_z, sizes.rear_hip_z, sizes.waist_z
        moved = {"rear": stack([0.0, 0.0, axis])}
    for i in LIMBS:
        x, y, z = (*front, front_z) if i < 2 else (*rear, rear_z - axis)
        across = y if i % 2 else -y  # limbs 2 and 4 are on the left
        moved[f"upper_{i + 1}"] = stack([x, across, z])
    return moved, stack([gap, 0.0, -axis])


def mjcf() -> str:
    """The body as an MJCF."""
    return resources.files("gaitsweep.papers.aoi2011.waist_quadruped").joinpath("body.xml").read_text()


@cache
def body() -> tuple[Tree, Geometry]:
    """The tree, and its geometry with the numbers of Table I."""
    from gaitsweep.dynamics.tree import tree_of  # MuJoCo, only for a job of this body

    return tree_of(mjcf())


_PAPER = "Aoi 2011"
_TABLE_1 = "Aoi 2011, Table I"
_SEARCH = "found by search"


_positive = Quantity.positive


def _gain(i: int, j: int, default: float = 0.0) -> Quantity:
    """The gain with which limb j pulls limb i."""
    return Quantity(
        f"K_{i}{j}", "rad/s", f"pull of limb {i} by limb {j} towards their desired phase difference", default,
        low=0.0, symbol=f"K_{{{i}{j}}}", source="Aoi 2011, eq. (6)",
    )  # fmt: skip


def _desired_lead(i: int, j: int, default: float | str) -> Quantity:
    """The lead of limb i to which limb j pulls it."""
    return Quantity(
        f"delta_star_{i}{j}", "rad", f"desired lead of limb {i} over limb {j}", default,
        circular=True, symbol=rf"\Delta^*_{{{i}{j}}}", source="Aoi 2011, eq. (6), (9)",
    )  # fmt: skip


def _of_bodies(
    name: str, unit: str, meaning: str, both: str, symbol: str, source: str = _TABLE_1
) -> tuple[Quantity, ...]:
    """A quantity of the front and of the rear body, by default the parameter `both`."""
    return tuple(
        _positive(f"{body}_{name}", unit, f"{meaning} of the {body} body", both,
                  f"{symbol}_\\mathrm{{{body[0].upper()}B}}", source)
        for body in ("front", "rear")
    )  # fmt: skip


def _flag(name: str, meaning: str, default: float, symbol: str, source: str = "") -> Quantity:
    """A choice between 0 and 1."""
    return Quantity(name, "1", meaning, default, low=0.0, high=1.0, symbol=symbol, source=source, whole=True)


def _share(name: str, meaning: str, default: float, symbol: str) -> Quantity:
    """A number from 0 to 1."""
    return Quantity(name, "1", meaning, default, low=0.0, high=1.0, symbol=symbol)


def _hips(axis: str, of_front: str, front: str, of_rear: str, rear: str) -> tuple[Quantity, Quantity]:
    """The places of the fore and of the hind hips along an axis."""
    symbol = f"{axis}_\\mathrm{{hip,"
    return (
        _positive(f"front_hip_{axis}", "m", f"hips {of_front}", front, f"{symbol}FB}}", _SEARCH),
        _positive(f"rear_hip_{axis}", "m", f"hips {of_rear}", rear, f"{symbol}RB}}", _SEARCH),
    )


def _gait(name: str, centre: float, width: float) -> tuple[Quantity, Quantity]:
    """The leads delta_13 at which a gait has this name."""
    symbol = rf"\Delta_{{13}}^\mathrm{{{name}}}"
    return (
        Quantity(
            f"{name}_centre", "rad", f"delta_13 at the centre of the gait {name}", centre,
            circular=True, symbol=symbol, source=_SEARCH,
        ),
        _positive(f"{name}_width", "rad", f"half width of the gait {name}, as a lead", width,
                  rf"w^\mathrm{{{name}}}", _SEARCH),
    )  # fmt: skip


# Where hips and the waist's axis are not level with the centres of mass.
HEIGHTS = (
    _positive("body_height", "m", "height of each body", 0.05, "h_B", _SEARCH),
    *_of_bodies("height", "m", "height", "body_height", "h", _SEARCH),
    *(
        Quantity(f"{body}_hip_z", "m", f"hips above the centre of mass of the {body} body", default,
                 symbol=rf"z_\mathrm{{hip,{body[0].upper()}B}}", source=_SEARCH)
        for body, default in (("front", 0.0), ("rear", "front_hip_z"))
    ),
    Quantity("waist_z", "m", "axis of the waist above the centres of mass", 0.0, symbol="z_w",
             source=_SEARCH),
)  # fmt: skip
# Where feet slip.
FRICTION = (
    _positive("mu", "1", "coefficient of friction between feet and ground", 1.0, r"\mu", ""),
    _positive("T_slip", "s", "time in which the touchdown point of a slipping foot follows it", 2e-4,
              r"T_\mathrm{slip}", ""),
)  # fmt: skip
PARAMETERS = (
    _positive("f", "Hz", "stiffness of the waist, as a frequency", 2.6, "f", "Aoi 2011, eq. (8)"),
    Quantity("beta", "1", "duty factor", 0.75, low=0.5, high=1.0, open_ends=True, symbol=r"\beta",
             source=_PAPER),
    _positive("kappa_0", "kg m2", "inertia that makes f a stiffness", 0.042, r"\kappa_0", _SEARCH),
    _positive("zeta_0", "1", "damping ratio of the waist", 1.0, r"\zeta_0", _PAPER),
    _positive("D", "m", "distance between the extreme positions of a foot", 0.056, "D", _PAPER),
    _positive("T_sw", "s", "duration of the swing", 0.1, r"T_\mathrm{sw}", _PAPER),
    _gain(1, 2, 10.0), _gain(2, 1, 10.0), _gain(3, 4, 10.0), _gain(4, 3, 10.0),
    _gain(1, 3), _gain(3, 1), _gain(2, 4), _gain(4, 2), _gain(1, 4), _gain(4, 1), _gain(2, 3), _gain(3, 2),
    _desired_lead(1, 2, math.pi), _desired_lead(3, 4, math.pi), _desired_lead(1, 3, math.pi),
    # a phase difference is the sum of those between
    _desired_lead(1, 4, "delta_star_13 + delta_star_34"),
    _desired_lead(2, 3, "delta_star_13 - delta_star_12"),
    _desired_lead(2, 4, "delta_star_13 - delta_star_12 + delta_star_34"),
    _flag("resetting", "1: phases are reset at landing; 0: they are not", 1.0, "r", "Aoi 2011, eq. (7)"),
    Quantity("gate", "1", "share of the swing's phase after which a touchdown is a landing", 0.5, low=0.0,
             high=1.0, open_ends=True, symbol="s_g", source=_SEARCH),
    _flag("late_reset", "1: landings after phi_AEP reset the phase too; 0: they do not", 1.0, "r_+"),
    _share("landing_actual", "beginning of the stance line: desired foot (0), actual foot (1), between", 0.0,
          "l"),
    _positive("kappa_1", "N m/rad", "stiffness of the hips", 16.3, r"\kappa_1", _SEARCH),
    _positive("sigma_1", "N m s/rad", "damping of the hips", 0.125, r"\sigma_1", _SEARCH),
    _positive("kappa_2", "N m/rad", "stiffness of the knees", 9.75, r"\kappa_2", _SEARCH),
    _positive("sigma_2", "N m s/rad", "damping of the knees", 0.0755, r"\sigma_2", _SEARCH),
    _positive("K_TL", "N/m", "spring of the ground under a foot", 3.6e4, r"K_\mathrm{TL}", _SEARCH),
    _positive("D_TL", "N s/m", "damper of the ground under a foot", 175.0, r"D_\mathrm{TL}", _SEARCH),
    _positive("K_N", "N/m", "spring of the ground, vertical", "K_TL", r"K_\mathrm{N}", _SEARCH),
    _positive("D_N", "N s/m", "damper of the ground, vertical", "D_TL", r"D_\mathrm{N}", _SEARCH),
    _share("D_rising", "share of the vertical damper that acts while a foot on the ground rises", 1.0, "d_+"),
    _flag("clamp", "1: the ground cannot pull; 0: eq. (A8) exactly", 0.0, "c"),
    _flag("anchor_kept", "1: a foot that bounces in stance is held where it was; 0: anew", 0.0, "a"),
    _positive("H", "m", "depth of the extreme positions below the hip", 0.133, "H", _SEARCH),
    Quantity("x_c", "m", "middle of the extreme positions, ahead of the hip", -0.0008, symbol="x_c",
             source=_SEARCH),
    *(
        _positive(f"H_{pair}", "m", f"depth H of the {pair} limbs", "H", rf"H_\mathrm{{{pair}}}", _SEARCH)
        for pair in ("fore", "hind")
    ),
    *(
        Quantity(f"x_c_{pair}", "m", f"middle of the extreme positions of the {pair} limbs", "x_c",
                 symbol=rf"x_\mathrm{{c, {pair}}}", source=_SEARCH)
        for pair in ("fore", "hind")
    ),
    _flag("fore_knees", "1: the knees of the fore limbs point ahead; 0: behind", 1.0, "k_F"),
    _flag("hind_knees", "1: the knees of the hind limbs point ahead; 0: behind", 0.0, "k_H"),
    _positive("h", "m", "height to which the swing lifts a foot", 0.0393, "h", _SEARCH),
    Quantity("swing_ease", "1", "slowing of the swing at its ends; 0: uniform x; 1/beta: the ground's speed",
             1.0, low=0.0, symbol="e", source=_SEARCH),
    _positive("dip", "m", "depth that a foot without landing reaches below", 0.009, "d", _SEARCH),
    _positive("body_mass", "kg", "mass of the front body and of the rear one", 1.0, "m_B", _TABLE_1),
    _positive("body_length", "m", "length of each body, hips in place", 0.1, "l_B", _TABLE_1),
    _positive("body_width", "m", "width of each body, hips at its sides", 0.1, "w_B", _TABLE_1),
    *_of_bodies("mass", "kg", "mass", "body_mass", "m"),
    *_of_bodies("length", "m", "length", "body_length", "l"),
    *_of_bodies("width", "m", "width", "body_width", "w"),
    *_hips("x", "ahead of the centre of mass of the front body", "0.048*(front_length/0.1)",
           "behind the centre of mass of the rear body", "0.048*(rear_length/0.1)"),
    *_hips("y", "beside the middle of the front body", "0.05*(front_width/0.1)",
           "beside the middle of the rear body", "0.05*(rear_width/0.1)"),
    _positive("body_distance", "m", "distance between the bodies' centres of mass",
              "0.05*(front_length/0.1) + 0.05*(rear_length/0.1)", "d_B", _SEARCH),
    _positive("link_mass", "kg", "mass of each of a limb's two links", 0.1, "m_L", _TABLE_1),
    _positive("link_length", "m", "length of each of a limb's two links", 0.08, "l_L", _TABLE_1),
    _positive("g", "m/s2", "gravitational acceleration", 9.8, "g", _PAPER),
    _positive("T_grow", "s", "time in which D and h grow from 0", 4.0, r"T_\mathrm{grow}", _SEARCH),
    _positive("T_hold", "s", "time for which the start's lead is held", 7.0, r"T_\mathrm{hold}", _SEARCH),
    Quantity("K_hold", "rad/s", "coupling towards the start's lead while it is held", 20.0, low=0.0,
             symbol=r"K_\mathrm{hold}", source=_SEARCH),
    *_gait("walk", 2.37, 0.24),
    *_gait("trot", 2.83, 0.22),
    *_gait("pace", 0.0, 1.2),
)  # fmt: skip
