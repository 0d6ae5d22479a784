"""Features of an MJCF that a located body has: contacts with the ground, joint limits; refusals of others."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from gaitsweep.dynamics.body.surfaces import Box, Edge, Plane, Surface, surface_of
from gaitsweep.dynamics.mjcf import cleaned, element_name, elements_with, named

_GEOM = mujoco.mjtGeom
_OFF = mujoco.mjtDisableBit
_GROUND = (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_BOX, _GEOM.mjGEOM_HFIELD)
_TOUCHING = (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_BOX, _GEOM.mjGEOM_CYLINDER)
_EXACT = 1e-12  # of directions that should be parallel or across
_Y_OF_Z = 5  # the place in MuJoCo's geom_xmat (9,) of the world's y component of a geom's z axis
_DEFAULT_SOLREF = (0.02, 1.0)  # MuJoCo's, in s and 1
_BISECTIONS = 60  # beyond which an interval of floats has no middle
_REMEDY = "set its contype and conaffinity to 0, or derive the model from MjcfModel, which MuJoCo steps"
# Fields of MjModel that a located body does not have: the field, its owner, the name in MJCF.
_ACTING = (
    ("geom_adhesion", "geom", "adhesion"),
    ("geom_surfacevel", "geom", "surfacevel"),
    ("geom_fluid", "geom", "fluidshape ellipsoid"),
    ("geom_gap", "geom", "gap"),
    ("jnt_actfrclimited", "joint", "actuatorfrcrange"),
    ("jnt_springyield", "joint", "springyield"),
    ("actuator_delay", "actuator", "a delay"),
    ("actuator_plugin", "actuator", "a plugin"),
)


@dataclasses.dataclass(frozen=True)
class Softness:
    """The spring K (N/m or N m/rad) and the damper D (N s/m or N m s/rad) of a stop."""

    K: float
    D: float


@dataclasses.dataclass(frozen=True)
class Touch:
    """A geom that may touch a surface of the ground.

    `points` (k, 3) m are the centres of its spheres, or its corners, in the body's frame; `radius` is theirs;
    `axes` (k, 3) are directions outwards if the points are instead the centres of the ends of a cylinder;
    `friction` is None without friction; `edges` are those of the surface that a capsule's side may touch.
    """

    geom: int
    body: int
    points: Float[np.ndarray, "points 3"]
    radius: float
    surface: Surface
    softness: Softness
    friction: float | None
    axes: Float[np.ndarray, "points 3"] | None = None
    edges: tuple[Edge, ...] = ()

    @property
    def contacts(self) -> int:
        """Number of contacts: one of each point, two of the side with each edge."""
        return len(self.points) + 2 * len(self.edges)


def touches(m: Any) -> list[Touch]:
    """The geoms of moving bodies that may touch a plane, box or height field of the world.

    Raises:
        ValueError: shapes may touch that have no located contact, or no stiffness; the message names them.
    """
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    weight = float(m.body_mass.sum() * np.linalg.norm(m.opt.gravity)) or math.inf
    result = []
    for one, other in _pairs(m):
        # the geom of the world first
        ground, geom = sorted((one, other), key=lambda i: int(m.body_weldid[m.geom_bodyid[i]]) != 0)
        if m.body_weldid[m.geom_bodyid[ground]] != 0 or _GEOM(m.geom_type[ground]) not in _GROUND:
            raise ValueError(
                f"{named(m, 'geom', one)} and '{element_name(m, 'geom', other)}' may touch, but contacts are "
                "located between a body and a plane, box or height field of the world only: "
                f"{_REMEDY}. Geoms with contype 1 and conaffinity 0 do not touch each other."
            )
        surface = surface_of(m, data, ground, _margin(m, ground, geom))
        _refuse_shape(m, data, geom, ground, surface)
        friction, solref, solimp, condim = _mixed(m, ground, geom)
        if condim not in (1, 3):
            raise ValueError(
                f"{named(m, 'geom', geom)} has condim {condim}, torsional or rolling friction, which "
                "located contacts do not have. Allowed: 1, 3."
            )
        body = int(m.geom_bodyid[geom])
        inverse_weight = float(m.body_invweight0[body, 0])
        softness = _softness(m, named(m, "geom", geom), solref, solimp, inverse_weight, weight)
        points, radius, axes = _points(m, data, geom, surface)
        sliding = friction if condim == 3 else None
        result.append(Touch(geom, body, points, radius, surface, softness, sliding, axes))
    _refuse_different_friction(m, result)
    return [dataclasses.replace(touch, edges=_edges(m, data, touch, result)) for touch in result]


def _edges(m: Any, data: Any, touch: Touch, touches_of_body: list[Touch]) -> tuple[Edge, ...]:
    """The edges of a box that the side of a capsule may touch above the level planes that it touches, too."""
    is_capsule = m.geom_type[touch.geom] == _GEOM.mjGEOM_CAPSULE
    if not (is_capsule and isinstance(touch.surface, Box)):
        return ()
    in_plane = touch.surface.is_along_y and _is_planar(m, data, touch.geom)
    if in_plane and _is_along_y(data, touch.geom):  # its ends meet what its side meets
        return ()
    planes = [other.surface for other in touches_of_body if other.geom == touch.geom]
    levels = [plane.origin[2] for plane in planes if isinstance(plane, Plane) and plane.is_level]
    return tuple(touch.surface.edges(in_plane, max(levels, default=-math.inf)))


def _refuse_different_friction(m: Any, touches_of_body: list[Touch]) -> None:
    """Refuse a geom that touches surfaces of different friction or softness, since it has one set of both."""
    first_of_geom: dict[int, Touch] = {}
    for touch in touches_of_body:
        first = first_of_geom.setdefault(touch.geom, touch)
        if (first.friction, first.softness) != (touch.friction, touch.softness):
            raise ValueError(
                f"{named(m, 'geom', touch.geom)} may touch the ground with different friction, solref or "
                "solimp, but a geom of located contacts has one of each: give planes, boxes and height "
                f"fields the same, or leave out the contact with one. {_REMEDY[0].upper()}{_REMEDY[1:]}."
            )


def limits(m: Any) -> dict[int, Softness]:
    """The limited hinges and slides, and the springs and dampers of their limits.

    Raises:
        ValueError: the stiffness of a limit is 0; the message names the joint.
    """
    if m.opt.disableflags & (_OFF.mjDSBL_LIMIT | _OFF.mjDSBL_CONSTRAINT):
        return {}
    return {
        j: _softness(
            m,
            named(m, "joint", j),
            m.jnt_solref[j],
            m.jnt_solimp[j],
            float(m.dof_invweight0[m.jnt_dofadr[j]]),
        )
        for j in np.flatnonzero(m.jnt_limited).tolist()
    }


def refusals(m: Any) -> Iterator[str]:
    """A sentence for each feature that a located body lacks, besides those that a tree lacks."""
    for field, kind, feature in _ACTING:
        for i in elements_with(m, field, -1.0 if field == "actuator_plugin" else 0.0):
            yield f"{named(m, kind, i)} has {feature}, which a located body does not have."
    if m.npair:
        yield "The MJCF has a contact pair, which a located body does not have: set the geoms' numbers."
    if m.opt.disableflags & _OFF.mjDSBL_ACTUATION or m.opt.disableactuator:
        yield "The MJCF disables actuators, which a located body does not support: remove the actuators."
    if m.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        yield "The flag override is enabled, which a located body does not have: set solref of the geoms."
    joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    turning = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    bias = (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    for k in range(m.nu):
        name = named(m, "actuator", k)
        if m.actuator_trntype[k] not in joint or m.jnt_type[m.actuator_trnid[k, 0]] not in turning:
            yield f"{name} does not act on a hinge or slide, but a located body has no other transmission."
        elif m.actuator_dyntype[k] != mujoco.mjtDyn.mjDYN_NONE:
            yield f"{name} has activation dynamics (dyntype), which a located body does not have."
        elif m.actuator_gaintype[k] != mujoco.mjtGain.mjGAIN_FIXED or m.actuator_biastype[k] not in bias:
            yield f"{name} is no motor, position, velocity or general actuator of fixed gain and affine bias."


def _pairs(m: Any) -> Iterator[tuple[int, int]]:
    """The pairs of geoms that may touch, by MuJoCo's filters."""
    if m.opt.disableflags & (_OFF.mjDSBL_CONTACT | _OFF.mjDSBL_CONSTRAINT):
        return
    weld = m.body_weldid[m.geom_bodyid]
    # the weld of the body that carries the weld of each geom
    carrier = m.body_weldid[m.body_parentid[weld]]
    excluded = {int(signature) for signature in m.exclude_signature}
    for one, other in itertools.combinations(range(m.ngeom), 2):
        types_match = (
            m.geom_contype[one] & m.geom_conaffinity[other] | m.geom_contype[other] & m.geom_conaffinity[one]
        )
        first_body, second_body = sorted((int(m.geom_bodyid[one]), int(m.geom_bodyid[other])))
        is_excluded = (first_body << 16) + second_body in excluded  # MuJoCo's signature of a pair of bodies
        apart = weld[one] != weld[other]
        family = any(weld[a] and weld[a] == carrier[b] for a, b in ((one, other), (other, one)))
        filtered = family and not m.opt.disableflags & _OFF.mjDSBL_FILTERPARENT
        if types_match and apart and not filtered and not is_excluded:
            yield one, other


def _mixed(m: Any, one: int, other: int) -> tuple[float, np.ndarray, np.ndarray, int]:
    """Sliding friction, solref, solimp and condim of a contact of two geoms, mixed as by MuJoCo."""
    first, second = sorted((one, other), key=lambda i: -m.geom_priority[i])
    if m.geom_priority[first] > m.geom_priority[second]:
        friction = float(m.geom_friction[first, 0])
        return friction, m.geom_solref[first], m.geom_solimp[first], int(m.geom_condim[first])
    friction = float(max(m.geom_friction[one, 0], m.geom_friction[other, 0]))
    mix = m.geom_solmix[[one, other]]
    share = mix[0] / mix.sum() if mix.sum() > 0.0 else 0.5
    refs = m.geom_solref[[one, other]]
    solref = share * refs[0] + (1.0 - share) * refs[1] if (refs[:, 0] > 0.0).all() else refs.min(axis=0)
    solimp = share * m.geom_solimp[one] + (1.0 - share) * m.geom_solimp[other]
    return friction, solref, solimp, int(max(m.geom_condim[one], m.geom_condim[other]))


def _margin(m: Any, one: int, other: int) -> float:
    """The distance (m) of two geoms at which they begin to touch."""
    margins = [float(m.geom_margin[geom]) for geom in (one, other)]
    return sum(margins) if _margins_add() else max(margins)


@functools.cache
def _margins_add() -> bool:
    """Whether the margins of two geoms add, or the larger one counts, as in older versions of MuJoCo."""
    m = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1" margin=".1"/><body pos="0 0 .1"><freejoint/>'
        '<geom size=".1" mass="1" margin=".1"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    return bool(data.contact[0].includemargin > 0.15)


def _softness(
    m: Any,
    owner: str,
    solref: Float[np.ndarray, " 2"],
    solimp: Float[np.ndarray, " 5"],
    w: float,
    load: float = math.inf,
) -> Softness:
    """The spring with the stretch at rest that MuJoCo's constraint has, and a damper of its damping ratio.

    At rest the constraint's force is F = aref / R with aref = k d r and R = (1 - d) w / d for the stretch r,
    the impedance d(r), between dmin and dmax, and the inverse inertia w (MuJoCo's documentation, Computation,
    "Constraint model", and Modeling, "Solver parameters"). The spring is F / r at F = `load` (N); for large
    loads d is dmax. Numbers outside their ranges are replaced as MuJoCo does.

    Raises:
        ValueError: the stiffness of solref is 0; the message names the owner, a geom or a joint.
    """
    low, high, midpoint = np.clip(solimp[[0, 1, 3]], mujoco.mjMINIMP, mujoco.mjMAXIMP).tolist()
    width, power = float(solimp[2]), max(1.0, float(solimp[4]))
    time, ratio = solref.tolist()
    if (time > 0.0) != (ratio > 0.0):  # one of each format
        time, ratio = _DEFAULT_SOLREF
    if time > 0.0:
        if not m.opt.disableflags & _OFF.mjDSBL_REFSAFE:
            time = max(time, 2.0 * m.opt.timestep)
        k = 1.0 / max(mujoco.mjMINVAL, (high * time * ratio) ** 2)
    elif time < 0.0:
        k = -time / high**2
        ratio = abs(ratio) / (2.0 * math.sqrt(-time))
    else:
        raise ValueError(
            f"{owner} has solref {time:g} {ratio:g}, so no stiffness: give two numbers above 0 (time "
            "constant, damping ratio), or below 0 (stiffness, damping)."
        )

    def spring(r: float) -> float:
        share = _rise(r / width, midpoint, power) if width > mujoco.mjMINVAL else 0.5
        d = low + (high - low) * share
        return k * d * d / ((1.0 - d) * w)

    deep = math.inf
    if math.isfinite(load):  # the force rises with the stretch: halve the interval that has it
        shallow = 0.0
        deep = load / spring(0.0)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (shallow + deep)
            if middle * spring(middle) > load:
                deep = middle
            else:
                shallow = middle
    K = spring(deep)
    return Softness(K, 2.0 * ratio * math.sqrt(K / w))


def _rise(x: float, middle: float, power: float) -> float:
    """MuJoCo's curve of the impedance, from 0 at x = 0 to 1 from x = 1 on."""
    if x >= 1.0:
        return 1.0
    if power == 1.0:
        return x
    if x <= middle:
        return x**power / middle ** (power - 1.0)
    return 1.0 - (1.0 - x) ** power / (1.0 - middle) ** (power - 1.0)


def _points(m: Any, data: Any, geom: int, surface: Surface) -> tuple[np.ndarray, float, np.ndarray | None]:
    """Centres of a geom's spheres or ends, or its corners, (k, 3) m in the body's frame, radius, m, and axes.

    In the plane of motion a cylinder along y is a disc, as are spheres at its ends; one across it is a
    rectangle. Others have axes.
    """
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, m.geom_quat[geom])
    turn = cleaned(matrix.reshape(3, 3))
    at = np.array(m.geom_pos[geom])
    size = m.geom_size[geom]
    shape = m.geom_type[geom]
    if shape == _GEOM.mjGEOM_SPHERE:
        return at[None], float(size[0]), None
    if shape == _GEOM.mjGEOM_BOX:
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        return cleaned(at + (signs * size) @ turn.T), 0.0, None
    axes = np.outer([1.0, -1.0], turn[:, 2])
    ends = cleaned(at + axes * size[1])
    in_plane = surface.is_along_y and _is_planar(m, data, geom)
    if shape == _GEOM.mjGEOM_CAPSULE or (in_plane and _is_along_y(data, geom)):
        return ends, float(size[0]), None
    if in_plane:
        y = data.xmat[m.geom_bodyid[geom]].reshape(3, 3)[1]  # the world's y axis in the body's frame
        sides = np.outer([1.0, -1.0, 1.0, -1.0], np.cross(y, turn[:, 2])) * size[0]
        return cleaned(np.repeat(ends, 2, axis=0) + sides), 0.0, None
    return ends, float(size[0]), axes


def _refuse_shape(m: Any, data: Any, geom: int, ground: int, surface: Surface) -> None:
    """Refuse a geom that has no located contact with a surface."""
    shape = _GEOM(m.geom_type[geom])
    kind = shape.name.partition("_")[2].lower()
    touched = element_name(m, "geom", ground)
    words = f"{named(m, 'geom', geom)} is of type {kind} and may touch '{touched}', but"
    if shape not in _TOUCHING:
        raise ValueError(f"{words} contacts are located of a sphere, capsule, box or cylinder: {_REMEDY}.")
    is_disc = shape == _GEOM.mjGEOM_CYLINDER and _is_planar(m, data, geom) and _is_along_y(data, geom)
    has_edges = shape in (_GEOM.mjGEOM_BOX, _GEOM.mjGEOM_CYLINDER) and not (is_disc and surface.is_along_y)
    if has_edges and isinstance(surface, Box):
        raise ValueError(
            f"{words} contacts with boxes of the world are located of spheres, capsules and cylinders along "
            "y of a planar body alone (hinges along y, slides along x or z), since edges may cross away from "
            f"corners: use these, or {_REMEDY}."
        )


def _is_planar(m: Any, data: Any, geom: int) -> bool:
    """Whether a geom moves in x and z alone, with its axis along y or across it."""
    body = int(m.geom_bodyid[geom])
    while body > 0:
        first = int(m.body_jntadr[body])
        for j in range(first, first + int(m.body_jntnum[body])):
            along_y = abs(float(data.xaxis[j, 1]))
            turns = m.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE and along_y > 1.0 - _EXACT
            slides = m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE and along_y < _EXACT
            if not (turns or slides):
                return False
        body = int(m.body_parentid[body])
    return _is_along_y(data, geom) or bool(abs(data.geom_xmat[geom, _Y_OF_Z]) < _EXACT)


def _is_along_y(data: Any, geom: int) -> bool:
    """Whether the z axis of a geom is along the world's y."""
    return bool(abs(data.geom_xmat[geom, _Y_OF_Z]) > 1.0 - _EXACT)
