"""Features of an MJCF that MJX lacks, ignores or computes otherwise, by the names of the elements.

MJX refuses most features that it does not have without naming the element; it ignores others, and then
simulates a body that differs from the MJCF. The latter were found by comparison with MuJoCo.
"""

# MuJoCo's compiled modules come without mjx.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from gaitsweep.dynamics.mjcf import element_name, elements_with
from gaitsweep.dynamics.mjx.corrections import collision_driver, mjx

# Fields of MjModel with an effect where they are not zero: field, kind of its owner, name in MJCF.
_ACTING = (
    ("geom_adhesion", "geom", "adhesion"),
    ("pair_adhesion", "pair", "adhesion"),
    ("geom_surfacevel", "geom", "surfacevel"),
    ("geom_fluid", "geom", "fluidshape ellipsoid"),
    ("jnt_springyield", "jnt", "springyield"),
    ("jnt_stiffnesspoly", "jnt", "a stiffness that is a polynomial"),
    ("dof_dampingpoly", "dof", "a damping that is a polynomial"),
    ("tendon_springyield", "tendon", "springyield"),
    ("tendon_stiffnesspoly", "tendon", "a stiffness that is a polynomial"),
    ("tendon_dampingpoly", "tendon", "a damping that is a polynomial"),
    ("actuator_delay", "actuator", "a delay"),
    ("sensor_delay", "sensor", "a delay"),
    ("sensor_interval", "sensor", "an interval"),
    ("actuator_actearly", "actuator", "actearly"),
    ("actuator_armature", "actuator", "an armature of its own"),
    ("actuator_damping", "actuator", "a damping of its own"),
    ("actuator_dampingpoly", "actuator", "a damping of its own that is a polynomial"),
)
# Types of elements: the field, the kind of its owner, MJX's types, MuJoCo's, and the field's name in MJCF.
_TYPES = (
    ("sensor_type", "sensor", mjx.SensorType, mujoco.mjtSensor, ""),
    ("eq_type", "eq", mjx.EqType, mujoco.mjtEq, ""),
    ("actuator_trntype", "actuator", mjx.TrnType, mujoco.mjtTrn, "a transmission "),
    ("actuator_dyntype", "actuator", mjx.DynType, mujoco.mjtDyn, "dyntype "),
    ("actuator_gaintype", "actuator", mjx.GainType, mujoco.mjtGain, "gaintype "),
    ("actuator_biastype", "actuator", mjx.BiasType, mujoco.mjtBias, "biastype "),
)
_MOST_LISTED = 3  # names in a sentence
_GROUPS = 31  # of actuators, each a bit of `disableactuator`
_NETFORCE = 3  # number of the way in which a sensor reduces contacts
_WORDS = {"jnt": "joint", "dof": "joint", "eq": "equality"}
_OFF = mujoco.mjtDisableBit
# Flags that add numbers and do not change the motion.
HARMLESS = (
    mujoco.mjtEnableBit.mjENBL_ENERGY,
    mujoco.mjtEnableBit.mjENBL_FWDINV,
    mujoco.mjtEnableBit.mjENBL_INVDISCRETE,
)
_GEOM = mujoco.mjtGeom
_SENSOR = mujoco.mjtSensor
_UNSEEN_BY_RANGEFINDERS = {_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_HFIELD, _GEOM.mjGEOM_SDF}
# Pairs of shapes, the lower number first, whose contacts MJX finds with the algorithm of MuJoCo C.
_SPHERE, _CAPSULE = _GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CAPSULE
_ON_PLANES = (_SPHERE, _CAPSULE, _GEOM.mjGEOM_ELLIPSOID, _GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_BOX)
_SAME_CONTACTS = {
    *((_GEOM.mjGEOM_PLANE, other) for other in _ON_PLANES),
    *((_SPHERE, _SPHERE), (_SPHERE, _CAPSULE), (_CAPSULE, _CAPSULE)),
}


def refusals(model: mujoco.MjModel) -> list[str]:
    """A sentence for each feature of a compiled model that MJX lacks or would ignore."""
    groups = (_of_types, _of_sensors, _of_parts, _of_contacts, _of_options)
    return [sentence for group in groups for sentence in group(model)]


def cautions(model: mujoco.MjModel) -> list[str]:
    """A sentence for each feature of a compiled model that MJX computes otherwise than MuJoCo C."""
    pairs_by_shapes: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    if not model.opt.disableflags & _OFF.mjDSBL_CONTACT:
        for one, other, _ in collision_driver.geom_pairs(model):
            shapes = _shape(model, one), _shape(model, other)
            if shapes not in _SAME_CONTACTS:
                names = " with ".join(f"'{_name(model, 'geom', i)}'" for i in (one, other))
                pairs_by_shapes[_words(shapes[0]), _words(shapes[1])].append(names)
    sentences = [
        f"Contacts between {one} and {other} ({_listed(pairs)}) are found by another algorithm than in "
        "MuJoCo C: motions through them may differ."
        for (one, other), pairs in pairs_by_shapes.items()
    ]
    for name in ("max_contact_points", "max_geom_pairs"):
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
        if number >= 0:
            most = int(model.numeric_data[model.numeric_adr[number]])
            sentences.append(f"Numeric '{name}' lets MJX look at {most} contacts only, MuJoCo C at all.")
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        free = [f"'{_name(model, 'body', i)}'" for i in _free_alone(model)]
        if free:
            sentences.append(
                f"Free bodies without joints ({_listed(free)}) may turn otherwise than in MuJoCo C, which "
                "treats their gyroscopic forces implicitly with the integrator implicitfast."
            )
    return sentences


def _free_alone(m: mujoco.MjModel) -> list[int]:
    """The free bodies without joints below them whose inertia depends on the axis."""
    bodies = []
    for j in np.flatnonzero(m.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        body = int(m.jnt_bodyid[j])
        alone = (m.body_rootid[m.jnt_bodyid] == m.body_rootid[body]).sum() == 1
        parts = np.flatnonzero(m.body_rootid == m.body_rootid[body])
        if alone and (parts.size > 1 or np.ptp(m.body_inertia[body]) > 0.0 or m.body_ipos[body].any()):
            bodies.append(body)
    return bodies


def untraceable(model: mujoco.MjModel, error: Exception) -> str:
    """The sentence for a body at whose step MJX raises an error, with the sensors at which it does.

    MJX's errors do not name the sensor. Its function of sensors has their type in a local variable, which the
    traceback still holds; without that variable the sentence names no sensor.
    """
    first = str(error).partition("\n")[0].rstrip(".")
    reason = f"{type(error).__name__}: {first}" if first else repr(error)
    trace = error.__traceback__
    names = ""
    while trace is not None:
        sensor_type = trace.tb_frame.f_locals.get("sensor_type")
        if sensor_type is not None:
            numbers = np.flatnonzero(model.sensor_type == int(sensor_type))
            names = f" (at {_listed([named(model, 'sensor', int(i)) for i in numbers])})"
        trace = trace.tb_next
    return f"MJX cannot step this MJCF{names}: {reason}."


def _of_types(m: mujoco.MjModel) -> Iterator[str]:
    """Elements of a type that MJX does not have, or of which it has a part only."""
    for field, kind, supported, all_types, type_name in _TYPES:
        for i, number in enumerate(getattr(m, field)):
            ignored = all_types is _SENSOR and number == _SENSOR.mjSENS_TACTILE
            if number == mujoco.mjtTrn.mjTRN_BODY and field == "actuator_trntype":
                yield f"{named(m, kind, i)} is an adhesion, which MJX does not have."
            elif number not in set(supported) or ignored:
                has = f"has {type_name}" if type_name else "is of type "
                yield f"{named(m, kind, i)} {has}{_words(all_types(number))}, which MJX does not have."


def _of_sensors(m: mujoco.MjModel) -> Iterator[str]:
    """Sensors of contacts and distances that MJX computes otherwise."""
    for i in np.flatnonzero(m.sensor_type == _SENSOR.mjSENS_CONTACT):
        ends = {mujoco.mjtObj(t) for t in (m.sensor_objtype[i], m.sensor_reftype[i])}
        others = ends - {mujoco.mjtObj.mjOBJ_UNKNOWN, mujoco.mjtObj.mjOBJ_GEOM}
        if others:
            kinds = ", ".join(sorted(map(_words, others)))
            yield f"{named(m, 'sensor', int(i))} is of contacts by {kinds}, but MJX has them by geom only."
        elif m.sensor_intprm[i, 1] == _NETFORCE:
            yield f"{named(m, 'sensor', int(i))} reduces contacts by netforce, which MJX does not have."
    unseen = {int(shape) for shape in m.geom_type} & _UNSEEN_BY_RANGEFINDERS
    for i in np.flatnonzero(m.sensor_type == _SENSOR.mjSENS_RANGEFINDER):
        if m.sensor_objtype[i] != mujoco.mjtObj.mjOBJ_SITE or m.sensor_dim[i] != 1:
            yield f"{named(m, 'sensor', int(i))} gives more than the distance from a site, which MJX ignores."
        elif unseen:
            shapes = " and ".join(sorted(_words(_GEOM(shape)) for shape in unseen))
            yield f"{named(m, 'sensor', int(i))} is a rangefinder, for which MJX does not see a {shapes}."


def _of_contacts(m: mujoco.MjModel) -> Iterator[str]:
    """Pairs of geoms whose contacts MJX does not have as they are declared."""
    for one, other, pair in collision_driver.geom_pairs(m):
        shapes = _shape(m, one), _shape(m, other)
        names = f"{named(m, 'geom', one)} ({_words(shapes[0])}) and '{_name(m, 'geom', other)}'"
        margin = m.pair_margin[pair] if pair >= 0 else m.geom_margin[one] + m.geom_margin[other]
        if not collision_driver.has_collision_fn(*shapes):
            yield f"{names} ({_words(shapes[1])}) may touch, but MJX has no contacts of these shapes."
        elif margin and {_GEOM.mjGEOM_MESH, _GEOM.mjGEOM_HFIELD} & set(shapes):
            yield f"{names} ({_words(shapes[1])}) have a margin, which MJX does not have for these shapes."
        elif m.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and _condim(m, one, other, pair) == 1:
            yield f"{names} have condim 1, which MJX does not have with the option cone elliptic."


def _condim(m: mujoco.MjModel, one: int, other: int, pair: int) -> int:
    """The condim of a contact: that of its declared pair, or of the geom with the higher priority."""
    if pair >= 0:
        return int(m.pair_dim[pair])
    ranked = sorted((one, other), key=lambda geom: m.geom_priority[geom])
    same = m.geom_priority[one] == m.geom_priority[other]
    return int(max(m.geom_condim[ranked])) if same else int(m.geom_condim[ranked[1]])


def _of_parts(m: mujoco.MjModel) -> Iterator[str]:
    """Elements with features that MJX ignores."""
    for field, kind, feature in _ACTING:
        for i in elements_with(m, field):
            yield f"{named(m, kind, i)} has {feature}, which MJX ignores."
    for kind in ("body", "geom", "actuator"):
        for i in elements_with(m, f"{kind}_plugin", -1.0):
            yield f"{named(m, kind, i)} has a plugin, which MJX ignores."
    for kind, limited in (("jnt", m.jnt_limited), ("tendon", m.tendon_limited)):
        width = np.diff(getattr(m, f"{kind}_range"))[:, 0] if len(limited) else np.zeros(0)
        # of both limits within their margins MJX takes the nearer; the range of a ball begins at 0
        both = limited.astype(bool) & (width < 2.0 * getattr(m, f"{kind}_margin"))
        if kind == "jnt":
            both &= m.jnt_type != mujoco.mjtJoint.mjJNT_BALL
        for i in np.flatnonzero(both):
            yield f"{named(m, kind, int(i))} can be within the margins of both limits, but MJX takes one."
    for i in np.flatnonzero(np.isin(m.eq_type, (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD))):
        yield f"{named(m, 'eq', int(i))} is a connect or weld, of whose acceleration MJX ignores a term."


def _of_options(m: mujoco.MjModel) -> Iterator[str]:
    """Options and flags that MJX does not have or ignores."""
    if m.opt.noslip_iterations:
        yield "The option noslip_iterations is set, which MJX ignores."
    groups = [g for g in range(_GROUPS) if m.opt.disableactuator >> g & 1]
    for i in np.flatnonzero(np.isin(m.actuator_group, groups)):
        yield f"{named(m, 'actuator', int(i))} is disabled by its group, which MJX ignores: remove it."
    for flag in mujoco.mjtEnableBit.__members__.values():
        if m.opt.enableflags & flag and flag not in HARMLESS and flag != mujoco.mjtEnableBit.mjNENABLE:
            yield f"The flag {_words(flag)} is enabled, which MJX ignores or does not have."
    if m.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        yield "The solver is PGS, which MJX does not have. Allowed: Newton, CG."
    fluid = m.opt.density > 0.0 or m.opt.viscosity > 0.0 or np.any(m.opt.wind)
    if m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST and fluid:
        yield "The integrator is implicitfast, for which MJX has no density, viscosity and wind."
    springs, dampers = (bool(m.opt.disableflags & bit) for bit in (_OFF.mjDSBL_SPRING, _OFF.mjDSBL_DAMPER))
    if springs != dampers:
        yield "The flag spring or damper is disabled, and MJX then leaves out both: set zeros instead."
    if m.opt.integrator not in (
        mujoco.mjtIntegrator.mjINT_EULER,
        mujoco.mjtIntegrator.mjINT_RK4,
        mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    ):
        yield "The integrator is one that MJX does not have. Allowed: Euler, RK4, implicitfast."


def contact_words(m: mujoco.MjModel, one: int, other: int, *, same: bool = True) -> str:
    """The words for a contact of two geoms; empty for shapes treated as in C, unless `same`."""
    one, other = sorted((one, other), key=lambda geom: m.geom_type[geom])
    as_in_c = (_shape(m, one), _shape(m, other)) in _SAME_CONTACTS
    if as_in_c and not same:
        return ""
    first, second = (f"{_words(_shape(m, i))} '{_name(m, 'geom', i)}'" for i in (one, other))
    note = "" if as_in_c else ", which MJX finds by another algorithm"
    return f"the contact of {first} with {second}{note}"


def named(m: mujoco.MjModel, kind: str, number: int) -> str:
    """The kind of an element and its name."""
    return f"{_WORDS.get(kind, kind).capitalize()} '{_name(m, kind, number)}'"


def _name(m: mujoco.MjModel, kind: str, number: int) -> str:
    """The name of an element, or its kind and number where it has none."""
    if kind == "dof":
        number = int(m.dof_jntid[number])
    return element_name(m, _WORDS.get(kind, kind), number)


def _shape(m: mujoco.MjModel, geom: int) -> mujoco.mjtGeom:
    """The shape of a geom."""
    return mujoco.mjtGeom(m.geom_type[geom])


def _words(member: mujoco.mjtGeom) -> str:
    """MJCF's name of a member of one of MuJoCo's enumerations."""
    return member.name.partition("_")[2].lower()


def _listed(names: Sequence[str]) -> str:
    """The first names, and the number of the others."""
    more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
    return ", ".join(names[:_MOST_LISTED]) + more
