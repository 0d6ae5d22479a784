"""A hybrid model of a body in an MJCF: its contacts and joint limits are located events of the kernels.

A start can be a rest on the ground, under constant targets of the actuators. It is followed down the
potential, along the overdamped motion q' = a(q) with the acceleration a at no velocity, by implicit Euler
steps that grow to Newton's steps for a(q) = 0 (pseudo-transient continuation: Kelley and Keyes 1998, SIAM J.
Numer. Anal. 35:508). Friction has no force at no slip, so on level ground a rest needs none. On a slope the
body as a whole creeps along the ground at the constant velocity at which friction carries it: velocities
along the ground are unknowns in place of the positions, which change nothing.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
import enum
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaitsweep.contract import Chart, Quantity, Rates, Recommended
from gaitsweep.dynamics.declarations import mode, variable
from gaitsweep.dynamics.declared import Values
from gaitsweep.dynamics.declared_model import DeclaredModel
from gaitsweep.dynamics.ground import ROUNDING, ground_field
from gaitsweep.dynamics.mjcf import OfMjcf, Stamps, compiled_content, content_key, joint_number
from gaitsweep.dynamics.section_coordinates import BodyCoordinates
from gaitsweep.dynamics.tree import integrate
from gaitsweep.dynamics.tree.spatial import rotation_of
from gaitsweep.near_miss import suggestion

if TYPE_CHECKING:
    from gaitsweep.dynamics.body.mechanics import LocatedBody


# Largest acceleration (m/s2, rad/s2) of a rest, and the one below which no further step is taken.
AT_REST = 1e-9
_EXACT = 1e-10
_STEPS = 400
_DIFFERENCE = 1e-6  # of positions (m, rad), for the derivative of accelerations
# The first step (s2) of the overdamped motion, and the factors by which steps may change.
_FIRST = 1e-3
_SHRINK = 0.25
_GROW = 4.0
_LONGEST = 1e12
_FARTHEST = 0.02  # largest change (m, rad) of a position in a step
_UNSTABLE = 1e-3  # rate of growth squared (1/s2) from which a rest is unstable; others are rounding
_TOPPLED = 1.0  # turn (rad) of the first body from its start


class Standing(enum.IntEnum):
    """Whether a body stands, or why not."""

    stands = 0
    no_rest = 1
    unstable = 2
    toppled = 3


WHY_NOT = (
    "the body does not stand still on the ground near its start: it has no rest there, or an unstable one, "
    "or it falls over"
)


class Rest(NamedTuple):
    """Positions (nq,) at rest, velocities (nv,) along a slope, their largest acceleration, m/s2 or rad/s2."""

    q: Float[Array, " nq"]
    v: Float[Array, " nv"]
    residual: Float[Array, ""]
    standing: Int[Array, ""]


_Moving: TypeAlias = tuple[Float[Array, " nq"], Float[Array, " nv"]]  # positions and velocities


class _Progress(NamedTuple):
    """A point of the overdamped motion, and the next one.

    `at`, `a` and `stiffness` are positions and velocities, their accelerations, and minus the derivative
    (nv, nv) of the accelerations by the unknowns, 1/s2 or 1/s; `ahead` are the next positions and velocities,
    `step` (s2) the step to them, `cut` whether it was cut to `_FARTHEST`; `steps` is their number.
    """

    at: _Moving
    a: Float[Array, " nv"]
    stiffness: Float[Array, "nv nv"]
    ahead: _Moving
    step: Float[Array, ""]
    cut: Bool[Array, ""]
    steps: Int[Array, ""]


def rest(
    body: LocatedBody,
    acceleration: Callable[[Float[Array, " nq"], Float[Array, " nv"]], Float[Array, " nv"]],
    inverse_inertia: Callable[[Float[Array, " nq"]], Float[Array, "nv nv"]],
    q: Float[Array, " nq"],
    creeping: Sequence[int],
) -> Rest:
    """The rest to which an overdamped body moves.

    Args:
        body: the body.
        acceleration: the accelerations (nv,) at positions (nq,) and velocities (nv,).
        inverse_inertia: the inverse of the joint-space inertia (nv, nv) at positions (nq,).
        q: the positions (nq,) of the start.
        creeping: the places in v of velocities of the whole body along the ground.
    """
    creeps = np.isin(np.arange(body.nv), creeping)
    end = _overdamped_motion(body, acceleration, q, creeps)
    at, v = end.at
    lowest = _lowest_stiffness(body, end, inverse_inertia(at), creeps)
    residual = _largest(end.a)
    standing = jnp.where(_turn(body, q, at) > _TOPPLED, Standing.toppled, Standing.stands)
    standing = jnp.where(lowest < -_UNSTABLE, Standing.unstable, standing)
    standing = jnp.where(residual < AT_REST, standing, Standing.no_rest)
    return Rest(at, v, residual, standing)


def _overdamped_motion(
    body: LocatedBody,
    acceleration: Callable[[Float[Array, " nq"], Float[Array, " nv"]], Float[Array, " nv"]],
    q: Float[Array, " nq"],
    creeps: Bool[np.ndarray, " nv"],
) -> _Progress:
    """The last step down the accelerations, which has the rest or the largest number of steps.

    Args:
        body, acceleration, q: as for `rest`.
        creeps: whether a velocity is along the ground: it is changed, and its position is not.
    """
    n = body.nv
    # the accelerations are written out once in the compiled program, for all of these points
    displacements = _DIFFERENCE * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])

    def moved(at: _Moving, change: Float[Array, " nv"]) -> _Moving:
        q, v = at
        return jnp.asarray(integrate(body.tree, q, jnp.where(creeps, 0.0, change), 1.0)), v + creeps * change

    def goes_on(at: _Progress) -> Bool[Array, ""]:
        return (at.steps < _STEPS) & (_largest(at.a) > _EXACT)

    def next_of(last: _Progress) -> _Progress:
        at = last.ahead
        a, *others = jax.vmap(lambda change: acceleration(*moved(at, change)))(displacements)
        stiffness = (jnp.stack(others[n:]) - jnp.stack(others[:n])).T / (2.0 * _DIFFERENCE)
        ratio = jnp.clip(_largest(last.a) / _largest(a), _SHRINK, _GROW)
        step = jnp.where(last.cut, last.step, jnp.minimum(last.step * ratio, _LONGEST))
        change = jnp.linalg.solve(jnp.eye(n) / step + stiffness, a)
        far = _largest(change) / _FARTHEST
        ahead = moved(at, change / jnp.maximum(far, 1.0))
        return _Progress(at, a, stiffness, ahead, step, far > 1.0, last.steps + 1)

    unknown = jnp.full(n, jnp.inf)
    first = jnp.asarray(_FIRST, float)
    begin = q, jnp.zeros(n)
    start = _Progress(begin, unknown, jnp.eye(n), begin, first, jnp.asarray(True), jnp.asarray(0))
    return jax.lax.while_loop(goes_on, next_of, start)


def _lowest_stiffness(
    body: LocatedBody,
    end: _Progress,
    inverse_inertia: Float[Array, "nv nv"],
    creeps: Bool[np.ndarray, " nv"],
) -> Float[Array, ""]:
    """The lowest eigenvalue (1/s2) of the stiffness of unit masses, without directions along the ground."""
    # in these coordinates the stiffness is symmetric, as that of a potential
    root = jnp.linalg.cholesky(inverse_inertia)
    symmetric = jnp.linalg.solve(root, jnp.where(creeps, 0.0, end.stiffness) @ root)
    if np.any(creeps):
        # places and heading on the ground change nothing, or by friction slowly
        along = jnp.eye(body.nv)[:, np.flatnonzero(creeps)]
        if body.is_free:
            q, _ = end.at
            heading = jnp.zeros((body.nv, 1)).at[3:6, 0].set(rotation_of(q[3:7])[2])
            along = jnp.concatenate([along, heading], axis=1)
        basis, _ = jnp.linalg.qr(jnp.linalg.solve(root, along))
        across = jnp.eye(body.nv) - basis @ basis.T
        symmetric = across @ symmetric @ across
    return jnp.min(jnp.linalg.eigvalsh(symmetric))


def _largest(values: Float[Array, " n"]) -> Float[Array, ""]:
    return jnp.max(jnp.abs(values), initial=0.0)


def _turn(body: LocatedBody, q: Float[Array, " nq"], after: Float[Array, " nq"]) -> Float[Array, ""]:
    """The angle (rad) by which the first body has turned by its free joint, or the largest by a hinge."""
    turns = [jnp.zeros(())]
    for i in body.elements.links_of_body(1):
        at = body.tree.q_of[i]
        if body.tree.links[i].kind == "free":
            turns.append(2.0 * jnp.arccos(jnp.clip(jnp.abs(q[at][3:] @ after[at][3:]), 0.0, 1.0)))
        elif body.tree.links[i].kind == "hinge":
            turns.append(jnp.abs(after[at][0] - q[at][0]))
    return jnp.max(jnp.stack(turns))


BODY = "body"  # the field of the parameters that has those of the MJCF
_BEYOND = "a contact of the body is not covered at its start ({})"
_LENGTHS = ("_size", "_radius", "_x", "_y", "_z")  # ends of the names of parameters that change a drawing


@dataclasses.dataclass(frozen=True)
class BodyModel(OfMjcf, DeclaredModel):
    """A body of an MJCF with oscillators, in the kernels, with located contacts and joint limits.

    1. A model gives `body_file`, `control` and `period`, and `rates` where it declares variables.
    2. It may give declarations, `keyframe`, `formulas`, and the optional members of a `DeclaredModel`.
    3. The engine alone calls the members that are built from the body and the declarations.

    Numbers of the MJCF are parameters: `BODY_mass`, `BODY_size`, `JOINT_damping`, `ACTUATOR_kp`,
    `GEOM_friction`, `gravity`, ... (`gaitsweep models NAME` lists them), which functions read as
    `params.body["BODY_mass"]`. `state.q` and `state.v` are MuJoCo's qpos and qvel.

    Contacts are of spheres, capsules, cylinders and corners of boxes with planes, boxes and height fields of
    the world (docs/own_model.md); `ground` makes level planes uneven: each point
    then meets the ground's tangent plane below it. The ground pushes with N = K depth + D rate while both
    this and the depth are positive (Kelvin and Voigt). Friction against
    the slip v is mu N v / sqrt(v2 + (mu N / G)2 + s2), s = 0.1 mm/s: Coulomb's for fast slips, a damper G for
    slow ones. By default K is the stiffness that MuJoCo's contact has at rest under the body's weight, D has
    its damping ratio, and G is D. Limits of joints are springs and dampers of the same kind.
    """

    _: dataclasses.KW_ONLY
    ground: str = ground_field()

    contacts_bounce: ClassVar[bool] = True
    # whether rows begin at rest on the ground, near the keyframe or the starts given (`standing_still`)
    begins_standing: ClassVar[bool] = False

    # formulas of parameters by others, which replace the MJCF's numbers: {"thigh_mass": "2*thigh_size**3"}
    formulas: ClassVar[Mapping[str, str | float]] = {}

    q = variable("1", "qpos of MuJoCo", count="nq", observed=False, signal=False)
    v = variable("1", "qvel of MuJoCo", count="nv", observed=False, signal=False)
    pushing = mode(False, "whether a stop pushes", count="stops")

    # functions written for an `MjcfModel` read `state.body.q`
    _members_of_state: ClassVar[Mapping[str, Any]] = {"body": property(lambda state: state)}

    @property
    def recommended(self) -> Recommended:
        """Steps by tolerances: stiff contacts take short steps, and flights long ones."""
        return Recommended("tsit5")

    @classmethod
    def _other_parameters(cls) -> list[str]:
        return [BODY, *super()._other_parameters()]

    @property
    def body(self) -> LocatedBody:
        """The mechanics of the MJCF."""
        return _body(*content_key(type(self)))

    @property
    def nq(self) -> int:
        """Number of positions."""
        return self.body.nq

    @property
    def nv(self) -> int:
        """Number of velocities."""
        return self.body.nv

    @property
    def stops(self) -> int:
        """Number of points that may touch the ground, and of limits of joints."""
        return len(self.body.stop_names)

    # what functions of a model may ask for

    def length_factor(self, params: Any, joint: str) -> Float[Array, ""]:
        """The factor (1) of the lengths of the body that a joint moves, by the joint's name."""
        m = self.body.elements.m
        body = int(m.jnt_bodyid[joint_number(m, joint)])
        return params.body[f"{self.body.elements.name_of_body(body)}_size"]

    def place_of_body(self, params: Any, joint: str) -> Float[Array, " 3"]:
        """The place (3,) m of the body that a joint moves in its parent, without that one's length factor."""
        m = self.body.elements.m
        body = int(m.jnt_bodyid[joint_number(m, joint)])
        name = self.body.elements.name_of_body(body)
        axes = zip("xyz", m.body_pos[body].tolist(), strict=True)
        return jnp.stack([jnp.asarray(params.body.get(f"{name}_{axis}", place)) for axis, place in axes])

    def actuator_gear(self, params: Any, actuator: int) -> Float[Array, ""]:
        """The gear (1) of an actuator, by its number."""
        return params.body[f"{self.body.elements.name_of_actuator(actuator)}_gear"]

    def actuator_gain(self, params: Any, actuator: int) -> Float[Array, ""]:
        """The gain (1) of a motor, by its number."""
        return params.body[f"{self.body.elements.name_of_actuator(actuator)}_gain"]

    def touches(self, state: Any, geom: str) -> Bool[Array, ""]:
        """Whether the ground pushes on a geom, by its name."""
        return jnp.any(jnp.stack([state.pushing[k] for k in self.body.stops_of(geom)]))

    def depth(self, params: Any, state: Any, geom: str) -> Float[Array, ""]:
        """The depth (m) of a geom's lowest point below the ground; negative above it."""
        depths, _ = self.body.depths_and_forces(params.body, state.q, state.v, params.ground)
        return jnp.max(jnp.stack([depths[k] for k in self.body.stops_of(geom)]))

    def load(self, params: Any, state: Any, geom: str) -> Float[Array, ""]:
        """The force (N) of the ground on a geom, along the ground's normal."""
        _, forces = self.body.depths_and_forces(params.body, state.q, state.v, params.ground)
        loads = [jnp.where(state.pushing[k], forces[k], 0.0) for k in self.body.stops_of(geom)]
        return jnp.sum(jnp.stack(loads))

    def standing_still(self, params: Any, state: Any) -> Rest:
        """The rest on the ground that is near a state, under the controls of its declared variables.

        Places along even ground keep their positions. On a slope the body creeps along it.

        Args:
            params: the parameters.
            state: the state; its velocities are taken as 0.

        Returns:
            The positions `q` (nq,), the velocities `v` (nv,), of which those of the whole body along a slope
            are not 0, the largest acceleration `residual` (m/s2, rad/s2) there, and `standing`, a number of
            `Standing`.
        """

        def acceleration(q: Float[Array, " nq"], v: Float[Array, " nv"]) -> Float[Array, " nv"]:
            pushing = self.body.heights(params.body, q, v, params.ground) > 0.0
            control = self.checked_control(params, state.replace(q=q, v=v, pushing=pushing))
            return self.body.accelerations(params.body, q, v, control, None, params.ground)

        creeping = self.body.velocities_along_ground if self.ground == "even" else ()
        return rest(
            self.body, acceleration, lambda q: self.body.inverse_inertia(params.body, q), state.q, creeping
        )

    # what the contract asks for

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        if self.ground != "even" and not self.body.has_level_plane:
            raise ValueError(
                f"ground is {self.ground.split()[0]}, which lies on level planes of the world, but no geom "
                "may touch one."
            )
        names = [quantity.name for quantity in self.body.parameters]
        for name in self.formulas:
            if name not in names:
                raise ValueError(f"formulas has {name}, no parameter of the body{suggestion(name, names)}")
        return (
            *super().parameters,
            *(
                dataclasses.replace(q, default=self.formulas.get(q.name, q.default))
                for q in self.body.parameters
            ),
        )

    def params(self, values: Values, /) -> Any:
        of_body = {quantity.name: jnp.asarray(values[quantity.name]) for quantity in self.body.parameters}
        fields = self._gathered(values)
        # contacts meet the ground's tangent planes
        fields["ground"] = dataclasses.replace(fields["ground"], rounding=ROUNDING)
        return self.Params(**fields, body=of_body)

    def own_ground(
        self, x: Float[Array, " *places"], y: Float[Array, " *places"], /
    ) -> Float[Array, " *places"] | None:
        return jnp.asarray(self.body.ground_height(x, y)) if self.body.has_uneven_surface else None

    def _started(self, start: Values) -> dict[str, Any]:
        q, v = self.started_at(start)
        return {**super()._started(start), "q": q, "v": v}

    def _placed(self, params: Any, state: Any) -> Any:
        state = self.complete(params, state)
        if self.begins_standing:
            at_rest = self.standing_still(params, state)
            # a row whose body does not stand has no start
            q = jnp.where(at_rest.standing == Standing.stands, at_rest.q, jnp.nan)
            v = state.v + at_rest.v
            # other variables may follow from the place of the rest
            state = self.complete(params, state.replace(q=q, v=v)).replace(q=q, v=v)
        # a part that begins in the ground is pushed from the start
        heights = self.body.heights(params.body, state.q, state.v, params.ground)
        state = state.replace(pushing=heights > 0.0)
        return self._within_bounds(state, self._bounds(params, state) > 0.0)

    def without_start(self, params: Any, state: Any, /) -> dict[str, Bool[Array, ""]]:
        has_no_rest = jnp.isnan(state.q[0])
        reasons = {WHY_NOT: has_no_rest} if self.begins_standing else {}
        if names := self.body.bound_names:
            reasons[_BEYOND.format("; ".join(dict.fromkeys(names)))] = jnp.isnan(state.v[0]) & ~has_no_rest
        return reasons

    def _bounds(self, params: Any, state: Any) -> Float[Array, " bounds"]:
        """The lengths (m) by which contacts are beyond what is covered; else negative."""
        return self.body.bounds(params.body, state.q) if self.body.bound_names else jnp.zeros((0,))

    def _within_bounds(self, state: Any, beyond: Bool[Array, " bounds"]) -> Any:
        """The state, with velocities that are not numbers where a contact is beyond what is covered."""
        if not self.body.bound_names:
            return state
        return state.replace(v=jnp.where(jnp.any(beyond), jnp.nan, state.v))

    def flow(self, params: Any, state: Any, /) -> Rates:
        from gaitsweep.dynamics.tree import rates

        control = self.checked_control(params, state)
        return {
            **self.rates(params, state),
            "q": jnp.asarray(rates(self.body.tree, state.q, state.v)),
            "v": self.body.accelerations(
                params.body, state.q, state.v, control, state.pushing, params.ground
            ),
        }

    def guards(self, params: Any, state: Any, /) -> Float[Array, " guards"]:
        from gaitsweep.dynamics.body.mechanics import RELEASE

        height = self.body.heights(params.body, state.q, state.v, params.ground)
        of_stops = jnp.where(state.pushing, -height - RELEASE, height)
        declared = super().guards(params, state)
        return jnp.concatenate([declared, of_stops, self._bounds(params, state)])

    @property
    def guard_names(self) -> tuple[str, ...]:
        return (*super().guard_names, *self.body.stop_names, *self.body.bound_names)

    def occurred(self, params: Any, state: Any, fired: Bool[Array, " guards"], /) -> Bool[Array, " guards"]:
        declared = len(super().guard_names)
        happened = super().occurred(params, state, fired[:declared])
        return jnp.concatenate([happened, fired[declared:]])

    def jump(self, params: Any, state: Any, fired: Bool[Array, " events"], /) -> Any:
        declared = len(super().guard_names)
        before = super().jump(params, state, fired[:declared])
        bounds_from = declared + self.stops
        pushing = before.pushing ^ fired[declared:bounds_from]
        after = self._within_bounds(before.replace(pushing=pushing), fired[bounds_from:])
        return self._stepped(params, before, after, jnp.zeros(()))  # declared footfalls

    def caveats(self) -> list[str]:
        names = ", ".join(dict.fromkeys(self.body.bound_names))
        ends = [f"a row ends as not_a_number where a contact is not covered: {names}"] if names else []
        return [*super().caveats(), *ends]

    def chart(self) -> Chart:
        return BodyCoordinates(self)

    def mjcf(self, values: Mapping[str, float]) -> str:
        xml = super().mjcf(values)
        defaults = {quantity.name: quantity.default for quantity in self.body.parameters}
        changed = [name for name, value in values.items() if name in defaults and value != defaults[name]]
        if any(name.endswith(_LENGTHS) for name in changed):
            return _with_lengths(xml, self.body, values)
        return xml


@functools.lru_cache(maxsize=32)
def _body(source: str, stamps: Stamps) -> LocatedBody:
    """The mechanics of a body, made once for each content of its files."""
    from gaitsweep.dynamics.body.mechanics import LocatedBody

    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        return LocatedBody(compiled_content(source, stamps))


def _with_lengths(xml: str, body: LocatedBody, values: Mapping[str, float]) -> str:
    """The MJCF with the lengths and places of some values, for drawings; others are those of the file."""
    import mujoco

    spec = mujoco.MjSpec.from_string(xml)
    spec.compile()
    sizes = {0: 1.0}  # of the world, then of each body after its parent
    for part in spec.bodies:
        if part.id == 0:
            continue
        name = body.elements.name_of_body(part.id)
        size = values.get(f"{name}_size", 1.0)
        sizes[part.id] = size
        place = [values.get(f"{name}_{axis}", x) for axis, x in zip("xyz", part.pos, strict=True)]
        part.pos = sizes[part.parent.id] * np.array(place)
        for joint in part.joints:
            joint.pos = size * joint.pos
        for site in part.sites:
            site.pos = size * site.pos
        for geom in part.geoms:
            radius = values.get(f"{body.elements.name_of_geom(geom.id)}_radius", geom.size[0])
            geom.size = size * np.array([radius, *geom.size[1:]])
            geom.pos = size * geom.pos
            geom.fromto = size * geom.fromto
    return spec.to_xml()
