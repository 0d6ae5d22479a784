"""Faults of a model's starts: those that have no effect, and bodies that begin in the ground.

A geom of an MJCF may begin so deep in the ground that its contacts launch the body.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from gaitsweep.contract import Model
from gaitsweep.dynamics.body.body_model import BodyModel
from gaitsweep.dynamics.declared import Declared
from gaitsweep.dynamics.mjcf import OfMjcf, compiled_mjcf, element_name, height_start
from gaitsweep.engine.content import cached_by_content
from gaitsweep.engine.kernel.program import Program
from gaitsweep.engine.kernel.row_functions import over_rows
from gaitsweep.engine.kernel.trace import Tracer, UnsupportedError
from gaitsweep.engine.stored_traces import dependences, stored
from gaitsweep.models.sampled_points import Columns


@cached_by_content(maxsize=64)
def idle_starts(model: Model) -> tuple[str, ...]:
    """The names of starts on which the state at t = 0 does not depend; of a model with a body, none."""
    if model.host_parameters:
        return ()
    return tuple(stored("idle_starts", model, (), lambda: _idle_starts(model)))


def _idle_starts(model: Model) -> list[str]:
    """`idle_starts` of a model that has not been traced before."""
    scalar = jax.ShapeDtypeStruct((), float)
    shapes = tuple({q.name: scalar for q in group} for group in (model.parameters, model.initial_conditions))

    def begun(values: Any, start: Any) -> Any:
        return model.init(model.params(values), start)

    tracer = Tracer(Program())
    inputs = tracer.inputs(shapes, 0, steady=False)
    starts = jax.tree.unflatten(jax.tree.structure(shapes), inputs)[1]
    try:
        state = tracer.read(jax.make_jaxpr(begun)(*shapes), inputs)
    except UnsupportedError:
        read = frozenset[str]().union(*dependences(begun, *shapes))
        return [name for name in starts if name not in read]
    needed = set(tracer.program.needed(node for leaf in state for node in leaf.ravel().tolist()))
    return [name for name, node in starts.items() if int(node) not in needed]


def sets_starts(model: Model) -> str:
    """The function that sets the starts in `idle_starts`."""
    own = isinstance(model, Declared) and type(model).complete is not Declared.complete
    return "complete" if own else "init"


# The depth from which a start is reported, as a multiple of that at which one contact carries the body.
_DEEP = 1.0
_DEEP_IN_STEPS = 2.0  # of MuJoCo's own contact, whose rest is deeper than its reference
_MAX_NAMED = 4  # geoms in a sentence
_ROWS_OF_C = 8  # rows of stepped bodies that are tried


def starts_in_ground(
    model: Model, values: Columns, starts: Columns, where: Callable[[int], str]
) -> list[str]:
    """Return a sentence if a body begins deeper in the ground than a contact that carries all of its weight.

    Args:
        model: the model; of another one than a body of an MJCF there is none.
        values, starts: parameters and starts (n,) of rows.
        where: function from the place of a row among these to words such as " at the start of row 3".
    """
    body = model.original
    if not isinstance(body, OfMjcf) or getattr(body, "begins_standing", False):
        return []
    is_located = isinstance(body, BodyModel)
    deep = _depths_of_located(body, values, starts) if is_located else _depths_of_stepped(body, starts)
    rows = [place for place, depths in enumerate(deep) if depths]
    if not rows:
        return []
    deepest = max(rows, key=lambda place: max(depth for depth, _ in deep[place].values()))
    depths = deep[deepest]
    names = sorted(depths, key=lambda name: -depths[name][0])
    listed = ", ".join(f"{name} {depths[name][0]:.2g} m" for name in names[:_MAX_NAMED])
    more = ", ..." if len(names) > _MAX_NAMED else ""
    depth, at_rest = depths[names[0]]
    start = height_start(type(body))
    keyframe = (
        f"the keyframe {body.keyframe}" if body.keyframe else "the MJCF (its keyframe, or the body's pos)"
    )
    lift = f"raise {keyframe}"
    if start is not None:
        height = float(np.asarray(starts[start])[deepest]) + depth
        lift = f"`start: {{{start}: {height:.3g}}}` in the job begins on the ground, or {lift}"
    standing = ", or write `start: standing` in the model file, which compiles for about half a minute more"
    subject = "these geoms are" if len(names) > 1 else "a geom is"
    return [
        f"{subject} in the ground{where(deepest)}: {listed}{more}. One contact carries the body at a depth "
        f"of {at_rest:.1g} m, so the ground launches it. To lift it: {lift}{standing if is_located else ''}."
    ]


def _depths_of_located(
    model: BodyModel, values: Columns, starts: Columns
) -> list[dict[str, tuple[float, float]]]:
    """The depth of each geom that is too deep, and that at which one contact carries the body, by row (m)."""
    points = [name for name in model.body.geom_of_stop if name is not None]
    if not points:
        return []

    def of_row(values: Any, start: Any) -> Any:
        params = model.params(values)
        state = model.init(params, start)
        return model.body.contact_depths(params.body, state.q, params.ground)

    depth, at_rest = over_rows(of_row, "start_depths", model)(dict(values), dict(starts))
    deep: list[dict[str, tuple[float, float]]] = []
    for of_points, rests in zip(depth, at_rest, strict=True):
        geoms: dict[str, tuple[float, float]] = {}
        for name, reached, rest in zip(points, of_points, rests, strict=True):
            # without weight there is no rest, and NaN is a start that cannot be made
            if 0.0 < _DEEP * rest < reached and reached > geoms.get(name, (0.0, 0.0))[0]:
                geoms[name] = float(reached), float(rest)
        deep.append(geoms)
    return deep


def _depths_of_stepped(model: OfMjcf, starts: Columns) -> list[dict[str, tuple[float, float]]]:
    """As `_depths_of_located`, of a body with MuJoCo's contacts, by MuJoCo C for the first rows."""
    import mujoco

    m = compiled_mjcf(type(model))
    data = mujoco.MjData(m)
    gravity = float(np.linalg.norm(m.opt.gravity))
    deep: list[dict[str, tuple[float, float]]] = []
    for row in range(min(_ROWS_OF_C, len(next(iter(starts.values()), [])))):
        q, _ = model.started_at({name: float(column[row]) for name, column in starts.items()})
        geoms: dict[str, tuple[float, float]] = {}
        if np.all(np.isfinite(q)):
            data.qpos[:] = q
            mujoco.mj_forward(m, data)
            for contact in data.contact:
                moving = [int(g) for g in contact.geom if m.body_weldid[m.geom_bodyid[g]] != 0]
                stiffness = _reference_stiffness(contact.solref, contact.solimp)
                rest = gravity / stiffness if len(moving) == 1 and stiffness > 0.0 else 0.0
                if 0.0 < _DEEP_IN_STEPS * rest < -contact.dist:
                    geoms[element_name(m, "geom", moving[0])] = -float(contact.dist), rest
        deep.append(geoms)
    return deep


def _reference_stiffness(solref: np.ndarray, solimp: np.ndarray) -> float:
    """The stiffness (1/s2) of MuJoCo's contact: the acceleration that it asks for at a depth of 1 m."""
    time, ratio = solref[:2]
    most = float(solimp[1])
    return 1.0 / (most * time * ratio) ** 2 if time > 0.0 else -float(time) / most**2
