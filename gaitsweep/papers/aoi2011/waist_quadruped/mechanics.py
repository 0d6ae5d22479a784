"""The quadruped's rigid-body mechanics: the tree with a row's values, feet, torques, ground forces."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from gaitsweep.dynamics import Ground
from gaitsweep.dynamics.tree import (
    Geometry,
    PointForce,
    forward_dynamics,
    movements,
    places,
    rescaled,
    velocity,
)
from gaitsweep.papers.aoi2011.waist_quadruped.kinematics import (
    HIP,
    KNEE,
    WAIST,
    Point,
    joint_angles,
    joint_rates,
)
from gaitsweep.papers.aoi2011.waist_quadruped.parameters import LIMBS, body, displacements, factors

# Height above the ground (m) at which a foot lifts off, 1/2000 of its depth in stance. At zero, contact could
# chatter without end: the damper lifts a foot on the ground, and in the air it falls at once.
RELEASE_HEIGHT = 1e-7
# The share of the limbs' stiffness and damping in the fastest motion of a stiff waist.
LIMBS_IN_TWIST = 0.35


def anchored_force(
    position: jax.Array,
    velocity: jax.Array,
    anchor: jax.Array,
    contact: jax.Array,
    K: jax.Array,
    D: jax.Array,
    rising: jax.Array | float = 1.0,
    clamp: jax.Array | float = 0.0,
) -> jax.Array:
    """Force of level ground at z = 0 on a foot (3,), N (Aoi et al. 2011, eq. A8).

    Args:
        position, velocity: of the foot in the world, (3,), m and m/s.
        anchor: x and y at touchdown, (2,), m.
        contact: whether the foot is on the ground, scalar bool.
        K, D: springs, N/m, and dampers, N s/m, along x, y and z, (3,).
        rising: share of the vertical damper that acts while the foot rises.
        clamp: if above zero, the ground cannot pull.
    """
    sunk = position - jnp.concatenate([anchor, jnp.zeros(1)])
    damper = jnp.stack([D[0], D[1], jnp.where(velocity[2] > 0.0, D[2] * rising, D[2])])
    force = -K * sunk - damper * velocity
    least = jnp.where(clamp > 0.0, 0.0, -jnp.inf)
    force = jnp.stack([force[0], force[1], jnp.maximum(force[2], least)])
    return jnp.where(contact, force, 0.0)


def carried(force: jax.Array, mu: jax.Array | float) -> jax.Array:
    """The share of the force along the ground that friction `mu` carries, 1 within the cone.

    A force (3,), N, that pulls the foot down has no load, so that it carries none.
    """
    along = jnp.hypot(force[0], force[1])
    limit = mu * jnp.maximum(force[2], 0.0)
    return jnp.where(along > limit, limit / jnp.where(along > 0.0, along, 1.0), 1.0)


def ground_axes(ground: Ground, x: jax.Array) -> jax.Array:
    """The ground's axes at places x (4,) m, (4, 3, 3): along it in the plane of x and z, y, and across it."""
    across = ground.normal(x)
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    along = jnp.stack([across[:, 2], zero, -across[:, 0]], axis=1)
    return jnp.stack([along, jnp.stack([zero, one, zero], axis=1), across], axis=1)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class WaistMechanics:
    """Stiffnesses, masses and lengths; units as in `PARAMETERS`, the waist's in N m/rad and N m s/rad.

    `numbers` has the fields of an mjx.Model that MuJoCo computes from masses and lengths, for the body in
    MJX; it is empty for the tree. `mu` and `T_slip` are None where feet do not slip, the fields of
    HEIGHT_NAMES are None in a level body, and `ground` is None where the ground is even.
    """

    kappa_w: jax.Array
    sigma_w: jax.Array
    kappa_1: jax.Array
    sigma_1: jax.Array
    kappa_2: jax.Array
    sigma_2: jax.Array
    K_TL: jax.Array
    D_TL: jax.Array
    K_N: jax.Array
    D_N: jax.Array
    D_rising: jax.Array
    clamp: jax.Array
    fore_knees: jax.Array
    hind_knees: jax.Array
    g: jax.Array
    front_mass: jax.Array
    front_length: jax.Array
    front_width: jax.Array
    rear_mass: jax.Array
    rear_length: jax.Array
    rear_width: jax.Array
    link_mass: jax.Array
    link_length: jax.Array
    front_hip_x: jax.Array
    front_hip_y: jax.Array
    rear_hip_x: jax.Array
    rear_hip_y: jax.Array
    body_distance: jax.Array
    numbers: dict[str, jax.Array]
    mu: jax.Array | None = None
    T_slip: jax.Array | None = None
    front_height: jax.Array | None = None
    rear_height: jax.Array | None = None
    front_hip_z: jax.Array | None = None
    rear_hip_z: jax.Array | None = None
    waist_z: jax.Array | None = None
    ground: Ground | None = None

    def geometry(self) -> Geometry:
        """The geometry of Table I's body, scaled to these masses and lengths."""
        tree, of_table_1 = body()
        mass, size = factors(self, jnp.stack)
        scaled = rescaled(tree, of_table_1, mass=mass, size=size)
        moved, centre = displacements(self, jnp.stack)
        names = [link.name for link in tree.links]
        # stacked, since precision mixed has no updates of arrays
        position = [scaled.position[i] + moved.get(name, 0.0) for i, name in enumerate(names)]
        com = [scaled.com[i] + (centre if name == "rear" else 0.0) for i, name in enumerate(names)]
        return dataclasses.replace(scaled, position=jnp.stack(position), com=jnp.stack(com))

    @property
    def bends(self) -> tuple[jax.Array, ...]:
        """The sign of each limb's knee angle: 1 where the knee points ahead of the limb, else -1."""
        fore, hind = (jnp.where(knees > 0.0, 1.0, -1.0) for knees in (self.fore_knees, self.hind_knees))
        return fore, fore, hind, hind

    def feet(self, q: jax.Array, v: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Positions (4, 3) m and velocities (4, 3) m/s of the feet in the world."""
        tree, _ = body()
        placed = places(tree, self.geometry(), q)
        moving = movements(tree, placed, v)
        lower = [tree.index(f"lower_{i + 1}") for i in LIMBS]
        feet = [placed[i].position(self._foot()) for i in lower]
        return jnp.stack(feet), jnp.stack([velocity(placed[i], moving[i], self._foot()) for i in lower])

    def _foot(self) -> jax.Array:
        """The position of a foot in its lower link's frame (3,), m."""
        return jnp.stack([jnp.zeros_like(self.g), jnp.zeros_like(self.g), -self.link_length])

    def from_hips(self, q: jax.Array, share: jax.Array | float = 1.0) -> Point:
        """X and z (4,) m of the feet relative to their hips, in their bodies' axes, times `share`."""
        upper = jnp.stack([q[i] for i in HIP])
        lower = upper + jnp.stack([q[i] for i in KNEE])
        down = -share * self.link_length
        return down * (jnp.sin(upper) + jnp.sin(lower)), down * (jnp.cos(upper) + jnp.cos(lower))

    def torques(
        self, q: jax.Array, v: jax.Array, x: jax.Array, z: jax.Array, desired: Point | None = None
    ) -> jax.Array:
        """Generalised forces (15,): PD control of the joints, eq. (4), and the spring of the waist.

        Args:
            q, v: positions and velocities of the tree.
            x, z: desired positions of the feet relative to their hips, (4,) m.
            desired: desired velocities of the feet, (4,) m/s each, where joints are damped relative to the
                desired rates; None: they are damped by their own rates.
        """
        tau = [jnp.zeros_like(self.g)] * 15
        tau[WAIST - 1] = -self.kappa_w * q[WAIST] - self.sigma_w * v[WAIST - 1]
        for i in LIMBS:
            hip, knee = joint_angles(x[i], z[i], self.link_length, self.bends[i])
            hip_rate, knee_rate = v[HIP[i] - 1], v[KNEE[i] - 1]
            if desired is not None:
                foot = x[i], z[i], desired[0][i], desired[1][i]
                desired_rates = joint_rates(*foot, self.link_length, self.bends[i])
                hip_rate, knee_rate = hip_rate - desired_rates[0], knee_rate - desired_rates[1]
            tau[HIP[i] - 1] = -self.kappa_1 * (q[HIP[i]] - hip) - self.sigma_1 * hip_rate
            tau[KNEE[i] - 1] = -self.kappa_2 * (q[KNEE[i]] - knee) - self.sigma_2 * knee_rate
        return jnp.stack(tau)

    def ground_forces(
        self, at: jax.Array, speed: jax.Array, anchors: jax.Array, contact: jax.Array
    ) -> list[PointForce]:
        """The force of the ground on each foot, eq. (A8), within the cone of friction where feet slip.

        On uneven ground a foot stands on the plane that touches the ground at its touchdown point, and the
        springs and dampers of eq. (A8) are along and across this plane.

        Args:
            at, speed: positions and velocities of the feet, (4, 3) m and m/s.
            anchors: touchdown points, (4, 2) m.
            contact: whether each foot is on the ground, (4,).
        """
        tree, _ = body()
        forces = self._contact_forces(at, speed, anchors, contact)
        if self.mu is not None:
            forces = [force * jnp.append(carried(force, self.mu) * jnp.ones(2), 1.0) for force in forces]
        if self.ground is not None:
            axes = ground_axes(self.ground, anchors[:, 0])
            forces = [force @ axes[i] for i, force in enumerate(forces)]
        return [PointForce(tree.index(f"lower_{i + 1}"), self._foot(), forces[i]) for i in LIMBS]

    def creep(self, at: jax.Array, speed: jax.Array, anchors: jax.Array, contact: jax.Array) -> jax.Array:
        """Velocities (4, 2), m/s, of the touchdown points of slipping feet; arguments as for `ground_forces`.

        The point follows its foot until spring and damper are on the cone of friction: it does 1 - 1/e of the
        way in `T_slip`.
        """
        assert self.mu is not None
        assert self.T_slip is not None
        rates = []
        for force in self._contact_forces(at, speed, anchors, contact):
            beyond = 1.0 - carried(force, self.mu)
            rates.append(-beyond * force[:2] / (self.K_TL * self.T_slip))
        if self.ground is None:
            return jnp.stack(rates)
        # the part along x of a velocity along the ground
        cosine = ground_axes(self.ground, anchors[:, 0])[:, 0, 0]
        return jnp.stack(rates) * jnp.stack([cosine, jnp.ones_like(cosine)], axis=1)

    def _contact_forces(
        self, at: jax.Array, speed: jax.Array, anchors: jax.Array, contact: jax.Array
    ) -> list[jax.Array]:
        """Forces without friction's limit, along the ground's axes; arguments as for `ground_forces`."""
        if self.ground is None:
            return [anchored_force(at[i], speed[i], anchors[i], contact[i], *self._ground()) for i in LIMBS]
        x = anchors[:, 0]
        axes, points = ground_axes(self.ground, x), jnp.stack([x, anchors[:, 1], self.ground(x)], axis=1)
        forces = []
        for i in LIMBS:
            along = axes[i] @ (at[i] - points[i]), axes[i] @ speed[i]
            forces.append(anchored_force(*along, jnp.zeros(2), contact[i], *self._ground()))
        return forces

    def heights(self, at: jax.Array) -> jax.Array:
        """Distances (4,) m of the feet, at positions (4, 3) m, from the ground; negative below it."""
        if self.ground is None:
            return at[:, 2]
        x = at[:, 0]
        return (at[:, 2] - self.ground(x)) * self.ground.normal(x)[:, 2]

    def _ground(self) -> tuple[jax.Array, ...]:
        """Springs (3,) N/m and dampers (3,) N s/m of the ground along x, y, z, `D_rising` and `clamp`."""
        springs, dampers = (self.K_TL, self.K_TL, self.K_N), (self.D_TL, self.D_TL, self.D_N)
        return jnp.stack(springs), jnp.stack(dampers), self.D_rising, self.clamp

    def accelerations(
        self, q: jax.Array, v: jax.Array, tau: jax.Array, forces: list[PointForce]
    ) -> jax.Array:
        """dv/dt (15,), eq. (1).

        Args:
            q, v: positions (16,) and velocities (15,) of the tree.
            tau: generalised forces of the joints, (15,).
            forces: forces of the ground on the feet.
        """
        tree, _ = body()
        return jnp.asarray(forward_dynamics(tree, self.geometry(), q, v, tau, forces, gravity=self.gravity()))

    def fastest_motion(self, farthest: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Rate (1/s) and damping ratio of the fastest motion, of the straightest limb or the waist.

        A limb is two rods on a hip whose compliance is that of half a body; ground and joints act as springs
        and dampers. A waist that is stiffer than the limbs twists the bodies against each other and against
        the limbs, of which `LIMBS_IN_TWIST` counts. Compared with the largest eigenvalue of the Jacobian of
        the whole body, the error is between -6 % and 50 %, for nine of ten parameter sets between 0 and 15 %;
        with waists that are far stiffer than the paper's, up to 150 % (`tests/engine/test_flow_spectrum.py`).

        Args:
            farthest: the largest distance of a foot from its hip, m.
        """
        # of the stiffer direction
        damper, spring = jnp.maximum(self.D_TL, self.D_N), jnp.maximum(self.K_TL, self.K_N)
        reach = jnp.minimum(farthest, 2.0 * self.link_length)
        cosine = reach * reach / (2.0 * self.link_length * self.link_length) - 1.0  # of the knee angle
        free = 1.0 + 0.5 * self.link_mass / jnp.minimum(self.front_mass, self.rear_mass)
        rods = cosine, self.link_mass, self.link_length
        c = free * _largest_eigenvalue(damper, self.sigma_1, self.sigma_2, *rods)
        k = free * _largest_eigenvalue(spring, self.kappa_1, self.kappa_2, *rods)
        twist = self._twist_compliance()
        c = jnp.maximum(c, twist * self.sigma_w + LIMBS_IN_TWIST * c)
        k = jnp.maximum(k, twist * self.kappa_w + LIMBS_IN_TWIST * k)
        root = jnp.sqrt(k)
        # stiffness and damping may be largest along different motions
        decays = 0.5 * c + jnp.sqrt(jnp.maximum(0.25 * c * c - 0.5 * k, 0.0))
        return jnp.maximum(root, decays), jnp.minimum(0.5 * c / root, 1.0)

    def _twist_compliance(self) -> jax.Array:
        """The rate at which a torque of 1 N m accelerates the waist, 1/(kg m2), from above.

        Counted are the roll inertias of flat bodies, and the limbs' masses at their hips.
        """
        limbs = 4.0 * self.link_mass
        front = self.front_mass * self.front_width**2 / 12.0 + limbs * self.front_hip_y**2
        rear = self.rear_mass * self.rear_width**2 / 12.0 + limbs * self.rear_hip_y**2
        return 1.0 / front + 1.0 / rear

    def gravity(self) -> jax.Array:
        """The acceleration of gravity in the world (3,), m/s2."""
        return jnp.stack([jnp.zeros_like(self.g), jnp.zeros_like(self.g), -self.g])


def _largest_eigenvalue(
    ground: jax.Array, hip: jax.Array, knee: jax.Array, cosine: jax.Array, mass: jax.Array, length: jax.Array
) -> jax.Array:
    """The largest eigenvalue of M^-1 K of a limb of two rods, with K its stiffness or damping.

    Args:
        ground, hip, knee: springs (N/m, N m/rad) or dampers (N s/m, N m s/rad).
        cosine: cosine of the knee angle.
        mass, length: of a rod, kg and m.
    """
    square = length * length
    determinant = 4.0 / 9.0 - 0.25 * cosine * cosine
    i11, i12, i22 = (x / (determinant * mass * square) for x in (1.0 / 3.0, -0.5 * cosine, 4.0 / 3.0))
    a11, a12, a22 = ground * square + hip + knee, ground * square * cosine - knee, ground * square + knee
    b11, b12 = i11 * a11 + i12 * a12, i11 * a12 + i12 * a22
    b21, b22 = i12 * a11 + i22 * a12, i12 * a12 + i22 * a22
    half = 0.5 * (b11 + b22)
    return half + jnp.sqrt(jnp.maximum(half * half - (b11 * b22 - b12 * b21), 0.0))
