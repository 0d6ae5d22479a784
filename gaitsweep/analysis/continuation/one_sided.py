"""Branch points of maps that are smooth only on each side of a corner, as where two feet land at once.

If two events coincide on a whole branch, their order differs on its two sides, and so do the modes at the
section and the derivatives of the map. If one of the two is still to come at the section, and moves the
state, even the coordinates of the branch differ. Each side has a smooth map of its own with a branch point,
where half of a second branch begins. Two halves on the same side of the parameter are a pitchfork with a
corner, x -> x + p x +- |x| x; two on different sides are transcritical.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from gaitsweep.analysis.continuation.arclength_step import BranchPoints, ContinuationProblem
from gaitsweep.analysis.continuation.newton import along
from gaitsweep.engine.poincare.maps import Points

Vector = Float[np.ndarray, " unknowns"]
Plane = Float[np.ndarray, "2 unknowns"]
# Distance from the branch point, in scaled coordinates, of the points at which a side is differentiated.
ALONG = 1e-4
# Largest smallest singular value of a side on which the map has a branch point too.
SINGULAR = 1e-3
# On one side of a corner: largest share of a displacement along the critical direction that the map adds.
NEARLY_FIXED = 0.1
# Largest change of the Jacobian over `ALONG`, as a share of its norm and 1.
CONTINUOUS = 0.05
# Most displacements that are tried for a side.
MOST_TRIED = 8
# The longest displacement, in units of `ALONG`.
LONGEST = 30.0
# The farthest image if coordinates are the same on both sides, in units of `ALONG`.
FARTHEST = 100.0
# Largest difference of the unit tangents of one branch on both sides.
ALIKE = 2e-3
# Weights of values at one, two and three distances: for their limit at 0, and for their derivative there.
LIMIT = np.array([3.0, -3.0, 1.0])
SLOPE = np.array([-2.5, 4.0, -1.5])


@dataclasses.dataclass(frozen=True)
class Side:
    """A branch point on one side of a corner, in scaled unknowns.

    Attributes:
        points: the branch point (1,) with the coordinates and modes of this side.
        push: (m, m) leads from displacements at the point of the branch to those at `points`.
        near: whether these two points are at one place.
        outward: the critical direction that leads into this side.
        tangents: the unit tangents of both branches.
        jacobian: that of the map at the branch point, in coordinates.
        w, null, bent: as in `branch_points`.
    """

    points: Points
    push: Float[np.ndarray, "unknowns unknowns"]
    near: bool
    outward: Vector
    tangents: Plane
    jacobian: Float[np.ndarray, "coordinates coordinates"]
    w: Float[np.ndarray, " equations"]
    null: Plane
    bent: Plane

    def rate(self, problem: ContinuationProblem, through: Vector) -> float:
        """A number with the sign of d(multiplier)/d(parameter) on the branch that goes `through`."""
        return multiplier_rate(problem, self.points, self.w, self.null, self.bent, through, self.outward)

    def half(self, through: Vector) -> Vector:
        """The tangent, into this side, of the other branch than that which goes `through`."""
        other = self.tangents[np.argmin(np.abs(self.tangents @ through))]
        share, *_ = np.linalg.lstsq(np.stack([self.outward, through], axis=1), other, rcond=None)
        return other * np.sign(share[0])


def multiplier_rate(
    problem: ContinuationProblem,
    points: Points,
    w: Float[np.ndarray, " equations"],
    null: Plane,
    bent: Plane,
    through: Vector,
    eigenvector: Vector,
) -> float:
    """A number with the sign of d(multiplier)/d(parameter) on the branch that goes `through`.

    Args:
        problem: the continuation problem, of one branch.
        points: the branch point (1,).
        w, null, bent: as in `branch_points`.
        through: the tangent (m,) of the branch, in scaled unknowns.
        eigenvector: the eigenvector (m,) of the multiplier 1, in scaled unknowns.
    """
    change = (null @ through) @ (bent @ eigenvector)
    return float(change * (_projection(problem, w, points) @ eigenvector) * np.sign(through[-1]))


def crossing_tangents(null: Plane, bent: Plane) -> Plane | None:
    """The unit tangents (2, m) of two branches that cross; None where none or only one is real."""
    form = bent @ null.T
    (low, high), vectors = np.linalg.eigh(0.5 * (form + form.T))
    if not low < 0.0 < high:
        return None
    pair = np.array([[np.sqrt(high), np.sqrt(-low)], [-np.sqrt(high), np.sqrt(-low)]])
    return pair @ vectors.T @ null / np.sqrt(high - low)


def both_sides(problem: ContinuationProblem, at: BranchPoints) -> list[Side]:
    """The branch point `at` (1,) as seen from both sides of it along its critical direction.

    Fewer than two where a side has no branch point there, or was not found.
    """
    scale, size = problem.scale()[0], at.points.at.shape[1]
    z = np.concatenate([at.points.at[0], at.drift[0], at.parameter]) / scale
    miss, J = problem.scaled_equations(at.points, z[None])
    if not (np.isfinite(miss).all() and np.isfinite(J).all()):
        return []
    w, _, null = singular_vectors(J[0])
    critical, component = _critical(null), _projection(problem, w, at.points)
    if component @ critical == 0.0:
        return []
    tried = _displacements(problem, at, component / (component @ critical), critical)
    spread = along(at.images.conserved_jacobian[:, problem.constraints.which])[0]
    same_branch = np.zeros(len(tried), int)
    sides: list[Side] = []
    for sign in (1.0, -1.0):
        shifts = sign * ALONG * (tried * scale)[:, :size]
        displaced = Points(at.points.at + shifts, at.points[same_branch].modes)
        images = problem[same_branch].evaluated(displaced, at.parameter[same_branch])
        for k in np.flatnonzero(images.sound):
            push = np.eye(len(z))
            push[:size, :size] = images.jacobian[k] * scale[:size] / scale[:size, None]
            push[:size, size:-1] = -spread * scale[size:-1] / scale[:size, None]
            push[:size, -1] = images.d_parameter[k] * scale[-1] / scale[:size]
            image = Points(images.points.at[[k]] - spread @ at.drift[0], images.points[[k]].modes)
            side = _side(problem, at, image, push, sign * ALONG * tried[k])
            if side is not None and all(_differ(side, known) for known in sides):
                sides.append(side)
                break
    return sides


def _differ(side: Side, other: Side) -> bool:
    """Whether two sides are not the same one."""
    return side.near != other.near or bool(side.near and side.outward @ other.outward < 0.0)


def _displacements(
    problem: ContinuationProblem, at: BranchPoints, component: Vector, critical: Vector
) -> Float[np.ndarray, "tried unknowns"]:
    """Displacements (n, m) with a critical component of 1: along the critical direction, then coordinates.

    The modes at the branch point are those of one side. With them, a displacement to the other side may not
    be a state of the model. But another displacement may have its image there, with the modes of that side.
    """
    scale, size = problem.scale()[0], at.points.at.shape[1]
    axes = np.zeros((size, len(component)))
    axes[:, :size] = np.eye(size)
    gradients = at.images.conserved_jacobian[0, problem.constraints.which] * scale[:size]
    axes[:, :size] -= axes[:, :size] @ np.linalg.pinv(gradients) @ gradients
    amount = axes @ component
    order = np.argsort(-np.abs(amount), kind="stable")[: MOST_TRIED - 1]
    order = order[np.abs(amount[order]) * LONGEST > 1.0]
    return np.concatenate([critical[None], axes[order] / amount[order, None]])


def _side(
    problem: ContinuationProblem,
    at: BranchPoints,
    image: Points,
    push: Float[np.ndarray, "unknowns unknowns"],
    displacement: Vector,
) -> Side | None:
    """The branch point `at` (1,) on the side of the `image` (1,) of a point with a `displacement` from it.

    None where the map with the modes of the image has no branch point there, or is not smooth.
    """
    scale, size = problem.scale()[0], image.at.shape[1]
    moved = push @ displacement
    moved[size:] = 0.0
    z = np.concatenate([image.at[0], at.drift[0], at.parameter]) / scale - moved
    points = Points((z * scale)[None, :size], image.modes)
    apart = problem.mapping.difference(points.at, at.points.at)[0] / scale[:size]
    near = bool(np.linalg.norm(apart) < FARTHEST * ALONG)
    _, J = problem.scaled_equations(points, (z + moved)[None])
    if not np.isfinite(J).all():
        return None
    w, _, null = singular_vectors(J[0])
    outward = _critical(null)
    across = _projection(problem, w, points)
    outward = outward * np.sign((across @ moved) * (across @ outward))
    steps = ALONG * np.arange(1.0, 4.0)[:, None] * outward
    miss, jacobians = problem.scaled_equations(points, z + steps)
    if not (np.isfinite(jacobians).all() and np.isfinite(miss).all()):
        return None
    fixed = np.linalg.norm(miss, axis=1) <= NEARLY_FIXED * np.linalg.norm(steps, axis=1)
    changes = np.linalg.norm(np.diff(jacobians, axis=0), axis=(1, 2))
    continuous = changes <= CONTINUOUS * (1.0 + np.linalg.norm(jacobians[0]))
    if not (fixed.all() and continuous.all()):
        return None
    J0 = np.tensordot(LIMIT, jacobians, 1)
    w, smallest, null = singular_vectors(J0)
    if smallest > SINGULAR:
        return None
    critical = _critical(null)
    outward = critical * np.sign(critical @ outward)
    other = null[0] * (null[1] @ outward) - null[1] * (null[0] @ outward)
    basis = np.stack([outward, other / np.linalg.norm(other)])
    # beside the branch point, so that all points are on this side
    beside = 0.5 * ALONG * np.stack([basis[1], -basis[1]])[:, None] + steps
    pairs = problem.scaled_equations(points, z + beside.reshape(-1, len(z)))[1]
    if not np.isfinite(pairs).all():
        return None
    along_outward = np.tensordot(SLOPE, jacobians, 1) / ALONG
    along_other = np.tensordot(LIMIT, pairs[:3] - pairs[3:], 1) / ALONG
    bent = np.stack([w @ along_outward, w @ along_other])
    tangents = crossing_tangents(basis, bent)
    if tangents is None:
        return None
    row_scale = problem.mapping.sizes(points.at)[0]
    jacobian = J0[:size, :size] * row_scale[:, None] / scale[:size] + np.eye(size)
    return Side(points, push, near, outward, tangents, jacobian, w, basis, bent)


def singular_vectors(J: Float[np.ndarray, "equations unknowns"]) -> tuple[Vector, float, Plane]:
    """The left singular vector of the smallest singular value, this value, and the two null vectors."""
    left, values, right = np.linalg.svd(J)
    return left[:, -1], float(values[-1]), right[-2:]


def _critical(null: Plane) -> Vector:
    """The unit vector of a plane along which the parameter does not change."""
    vector = null[0] * null[1, -1] - null[1] * null[0, -1]
    length = np.linalg.norm(vector)
    return vector / length if length > 0.0 else null[0]


def _projection(problem: ContinuationProblem, w: Float[np.ndarray, " equations"], points: Points) -> Vector:
    """The left null vector w of the scaled equations, as a covector (m,) of the scaled coordinates."""
    size = points.at.shape[1]
    covector = np.zeros(len(w) + 1)
    covector[:size] = w[:size] / problem.mapping.sizes(points.at)[0]
    return covector * problem.scale()[0]
