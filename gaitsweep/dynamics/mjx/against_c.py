"""Comparison of a model of an MJCF with MuJoCo C: the first step that differs, and the likely cause.

MuJoCo C takes the controls that the model gave, so that the bodies alone are compared. Where two motions
diverge, each step before is repeated in C from the model's own state: a step that differs by itself has a
cause, and without such a step the motion is merely sensitive to rounding.
"""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from gaitsweep.cache_folder import cache_folder, load_cached, store_cached
from gaitsweep.contract import Quantity
from gaitsweep.dynamics.mjcf import data_at_keyframe
from gaitsweep.dynamics.mjx.mjx_body import BodyState
from gaitsweep.dynamics.mjx.refusals import cautions, contact_words, named
from gaitsweep.expression import in_order, resolve

if TYPE_CHECKING:
    from gaitsweep.dynamics.mjx.mjcf_model import MjcfModel

FIRST_USE = 64  # steps of the comparison when an MJCF is first used
TOLERANCE = 1e-5  # of a coordinate, relative to its size where that is above 1
# Difference of a single step, by the same measure, above the tolerance of MuJoCo's solver.
_STEP_TOLERANCE = 1e-7
_EXACT = 1e-14  # the tolerance of the solver of constraints at which its share of a difference is gone
_RANDOM_STARTS = 8
_RANDOM_SIZES = (0.1, 1.0)  # of random velocities and changes of place, in the units of the MJCF
_DRAWN = 8  # states drawn for each random start, of which one without deep contacts is taken
_SHALLOW = 1e-3  # m, depth of a contact below which a random state is taken
_CACHE = "mjcf_comparisons"


Start = tuple[str, mujoco.MjData]  # the name of a state from which both begin, and that state


@dataclasses.dataclass(frozen=True)
class Divergence:
    """The first step at which a coordinate differs by more than the tolerance, and the likely cause.

    `start` names the state from which both begin; `ours` and `theirs` are the coordinate in the model and in
    MuJoCo C; without a `cause` the motion is merely sensitive to rounding.
    """

    start: str
    step: int
    coordinate: str
    element: str
    ours: float
    theirs: float
    cause: str

    def __str__(self) -> str:
        cause = self.cause or "no step by itself: this motion enlarges differences of rounding"
        return (
            f"From {self.start}, {self.coordinate} ({self.element}) is {self.ours:.7g} at step {self.step}, "
            f"but {self.theirs:.7g} in MuJoCo C; likely cause: {cause}."
        )


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Comparison of the motions of a model with those of MuJoCo C.

    `starts` counts the states from which both begin, `steps` the steps from each; `largest` is the largest
    difference of a coordinate before a motion diverges.
    """

    starts: int
    steps: int
    largest: float
    divergences: list[Divergence]

    @property
    def caused(self) -> list[Divergence]:
        """The divergences that have a cause."""
        return [divergence for divergence in self.divergences if divergence.cause]


def compare(model: MjcfModel, steps: int) -> Comparison:
    """Step a model and MuJoCo C from each keyframe and from random states, at the model's defaults.

    Args:
        model: the model.
        steps: steps from each state.
    """
    model = _with_mjx(model)
    with jax.enable_x64(True), jax.default_device(jax.devices("cpu")[0]):
        side_by_side = _SideBySide(model, steps)
        m = model.mjx_body.mj_model
        starts = [*_keyframe_starts(m), *_random_starts(m, model.mjx_body.at_start())]
        results = [side_by_side.from_start(*start) for start in starts]
    divergences = [divergence for divergence, _ in results if divergence is not None]
    return Comparison(len(starts), steps, max(largest for _, largest in results), divergences)


class _SideBySide:
    """The steps of a model, as one compiled program, and those of MuJoCo C.

    Args:
        model: the model.
        steps: steps from each state.
    """

    def __init__(self, model: MjcfModel, steps: int) -> None:
        self._body = model.mjx_body
        self._steps = steps
        self._m = m = self._body.mj_model
        # the same with constraints that are solved to rounding
        self._exact = copy.copy(m)
        self._exact.opt.tolerance = _EXACT
        self._params, self._state = _at_default(model)
        dt = jnp.asarray(m.opt.timestep)

        def step(carry: Any, step_inputs: Any) -> Any:
            """One step from the state of the step before, or from a start of its own."""
            params, state = carry
            before, begins, tolerance = step_inputs
            state = jax.tree.map(lambda new, old: jnp.where(begins, new, old), before, state)
            after = model.step_with({"opt.tolerance": tolerance}, params, state, dt)
            return (params, after), (after, model.checked_control(params, state))

        def run(params: Any, states: Any, begins: Any, tolerance: Any) -> Any:
            first = jax.tree.map(lambda leaf: leaf[0], states)
            return jax.lax.scan(step, (params, first), (states, begins, tolerance))[1]

        # XLA's optimizations would take longer than they save
        options: dict[str, Any] = {"xla_backend_optimization_level": 0}
        if jax.__version_info__ < (0, 11):
            options["xla_cpu_use_fusion_emitters"] = False
        states = jax.tree.map(lambda leaf: jnp.stack([leaf] * steps), self._state)
        example = self._params, states, jnp.zeros(steps, bool), jnp.zeros(steps)
        self._program = jax.jit(run).lower(*example).compile(options)

    def from_start(self, name: str, start: mujoco.MjData) -> tuple[Divergence | None, float]:
        """The divergence of the motion from a start, if there is one, and the largest difference before."""
        body = self._state.body
        body = BodyState(
            q=jnp.array(start.qpos),
            v=jnp.array(start.qvel),
            act=jnp.array(start.act),
            warm=jnp.zeros_like(body.warm),
            time=jnp.full_like(body.time, start.time),
        )
        first = self._state.replace(body=body, sensors=0.0)
        states = jax.tree.map(lambda leaf: jnp.stack([leaf] * self._steps), first)
        after, controls = self._stepped(states, False, self._m.opt.tolerance)
        ours = _numbers(after)
        largest = 0.0
        data = self._body.at_start()
        _set_state(data, jax.tree.map(np.asarray, body), start.time)
        for k, control in enumerate(controls):
            theirs = _after_step(self._m, data, control)
            differences = _differences(ours[k], theirs)
            if (differences > TOLERANCE).any():
                i = int(np.argmax(differences > TOLERANCE))
                before = jax.tree.map(lambda old, new: np.concatenate([old[:1], new[:-1]]), states, after)
                cause = self._cause(i, k + 1, before, ours, controls, start.time)
                values = float(ours[k, i]), float(theirs[i])
                return Divergence(name, k + 1, *_element(self._m, i), *values, cause), largest
            largest = max(largest, float(differences.max(initial=0.0)))
        return None, largest

    def _stepped(self, states: Any, begins: bool, tolerance: float) -> tuple[Any, np.ndarray]:
        """The states after each step, and its controls; with `begins` each step has its own start."""
        flags = np.full(self._steps, begins)
        outputs = self._program(self._params, states, flags, np.full(self._steps, tolerance))
        return jax.tree.map(np.asarray, outputs)

    def _cause(
        self, i: int, steps: int, before: Any, ours: np.ndarray, controls: np.ndarray, time: float
    ) -> str:
        """The likely cause of a difference of number `i`, found in the first step that differs by itself.

        Args:
            i: the number that differs.
            steps: the steps from the start to that difference.
            before: the model's states before each step.
            ours: the model's numbers after each step (steps, n).
            controls: the controls of each step (steps, nu).
            time: the time (s) of the start.
        """
        m = self._m
        size_of_state = m.nq + m.nv + m.na  # sensors follow
        exact = _numbers(self._stepped(before, True, _EXACT)[0])
        solver_differs = False
        for k in range(steps):
            state = jax.tree.map(lambda leaf, k=k: leaf[k], before.body)
            begin = time + k * m.opt.timestep
            in_c, data = self._step_in_c(m, state, begin, controls[k])
            exact_in_c, _ = self._step_in_c(self._exact, state, begin, controls[k])
            differences = _differences(exact[k], exact_in_c)
            if differences[:size_of_state].max(initial=0.0) > _STEP_TOLERANCE:
                return f"{_acting_constraints(m, data)} (from step {k + 1} on)"
            if i >= size_of_state and differences[i] > TOLERANCE:
                kind = mujoco.mjtSensor(m.sensor_type[_sensor_of(m, i - size_of_state)]).name
                return f"MJX computes a sensor of type {kind.partition('_')[2].lower()} differently"
            solver_differs |= bool(_differences(ours[k], in_c).max(initial=0.0) > _STEP_TOLERANCE)
        if solver_differs:
            return f"the solver of constraints, which both end at the option tolerance {m.opt.tolerance:g}"
        return ""

    def _step_in_c(
        self, m: mujoco.MjModel, state: BodyState, begin: float, control: np.ndarray
    ) -> tuple[np.ndarray, mujoco.MjData]:
        """The numbers after a step of MuJoCo C from a state at a time (s), and the data of that step."""
        data = self._body.at_start()
        _set_state(data, state, begin)
        return _after_step(m, data, control), data


def at_first_use(model: MjcfModel) -> list[str]:
    """Compare a model's MJCF with MuJoCo C: a sentence for each difference, kept in the cache."""
    file, first_control = _entry(model)
    if file is not None and (stored := load_cached(file)) is not None:
        return json.loads(stored)
    sentences = _sentences(model, first_control)
    if file is not None:
        store_cached(file, json.dumps(sentences).encode())
    return sentences


def compared_before(model: MjcfModel) -> bool:
    """Whether the cache has the comparison of a model's MJCF, so that `at_first_use` takes no time."""
    file, _ = _entry(model)
    return file is not None and load_cached(file) is not None


def _entry(model: MjcfModel) -> tuple[Path | None, np.ndarray]:
    """The file of a model's comparison in the cache, None without a cache; and the control at the start."""
    model = _with_mjx(model)
    with jax.enable_x64(True), jax.default_device(jax.devices("cpu")[0]):
        params, state = _at_default(model)
        # of a jaxpr, the text would lack the numbers of arrays
        control = jax.jit(model.checked_control).lower(params, state).as_text()
        first = np.asarray(model.checked_control(params, state))
    leaves = [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves((params, state))]
    versions = [version(name) for name in ("gaitsweep", "mujoco", "mujoco-mjx")]
    made_of = hashlib.sha256(repr((model.data_digest, control, leaves, versions, FIRST_USE)).encode())
    folder = cache_folder(_CACHE)
    return (None if folder is None else folder / f"{made_of.hexdigest()}.json"), first


def _with_mjx(model: MjcfModel) -> MjcfModel:
    """The model stepped by MJX, whatever steps it in a run."""
    return dataclasses.replace(model, dynamics="mjx")


def _sentences(model: MjcfModel, control: np.ndarray) -> list[str]:
    """A sentence for each difference, with the `control` at the default start."""
    m = model.mjx_body.mj_model
    sentences = cautions(m)
    keyframe_control = np.asarray(model.keyframe_ctrl)
    if keyframe_control.any() and not np.array_equal(keyframe_control, control):
        sentences.append(
            "The keyframe of the start has controls (ctrl), but control gives others there: "
            "keyframe_ctrl has them."
        )
    causes = {divergence.cause: divergence for divergence in reversed(compare(model, FIRST_USE).caused)}
    return [
        *sentences,
        *(f"The MJCF moves differently in MuJoCo C. {divergence}" for divergence in causes.values()),
    ]


def _at_default(model: MjcfModel) -> tuple[Any, Any]:
    """Parameters and state at a model's defaults."""
    values = _defaults(model.parameters, {})
    params = model.params({name: jnp.asarray(value) for name, value in values.items()})
    start = _defaults(model.initial_conditions, values)
    return params, model.init(params, {name: jnp.asarray(value) for name, value in start.items()})


def _defaults(quantities: Iterable[Quantity], values_before: dict[str, float]) -> dict[str, float]:
    """The defaults of quantities by name; near 1 in its bounds for one that has none."""
    formulas = {
        q.name: float(np.clip(1.0, q.low, q.high)) if q.default is None else q.default for q in quantities
    }
    values = resolve(in_order(formulas), values_before)
    return {name: float(values[name]) for name in formulas}


def _keyframe_starts(m: mujoco.MjModel) -> Iterator[Start]:
    """The states of the keyframes; that of the joints if there is none."""
    if not m.nkey:
        yield "the start", mujoco.MjData(m)
    for i in range(m.nkey):
        yield f"keyframe '{m.key(i).name or i}'", data_at_keyframe(m, i)


def _random_starts(m: mujoco.MjModel, at_start: mujoco.MjData) -> Iterator[Start]:
    """Random states: every second one is moved by C to its first contact."""
    random = np.random.default_rng(0)
    longest = min(1000, int(1.0 / m.opt.timestep))
    for i in range(_RANDOM_STARTS):
        size = _RANDOM_SIZES[i // 2 % len(_RANDOM_SIZES)]
        drawn = [_random_state(m, at_start, size, random) for _ in range(_DRAWN)]
        depths = [_deepest(data) for data in drawn]
        shallow = [k for k, depth in enumerate(depths) if depth < _SHALLOW]
        data = drawn[shallow[0] if shallow else int(np.argmin(depths))]
        steps = 0
        while i % 2 and not data.ncon and steps < longest and np.isfinite(data.qacc).all():
            mujoco.mj_step(m, data)
            steps += 1
        data.time = 0.0
        yield f"random state {i + 1}", data


def _random_state(
    m: mujoco.MjModel, at_start: mujoco.MjData, size: float, random: np.random.Generator
) -> mujoco.MjData:
    """A random state around the start, with joints within their limits."""
    data = mujoco.MjData(m)
    for name in ("qpos", "act", "mocap_pos", "mocap_quat"):
        getattr(data, name)[:] = getattr(at_start, name)
    mujoco.mj_integratePos(m, data.qpos, 0.5 * size * random.standard_normal(m.nv), 1.0)
    for j in np.flatnonzero(m.jnt_limited & (m.jnt_type != mujoco.mjtJoint.mjJNT_BALL)):
        low, high = m.jnt_range[j]
        data.qpos[m.jnt_qposadr[j]] = random.uniform(low, high)
    data.qvel[:] = size * random.standard_normal(m.nv)
    data.act[:] = random.uniform(size=m.na)
    mujoco.mj_forward(m, data)
    return data


def _deepest(data: mujoco.MjData) -> float:
    """The depth (m) of the deepest contact."""
    return max((-float(contact.dist) for contact in data.contact), default=0.0)


def _numbers(states: Any) -> np.ndarray:
    """The numbers (steps, n) that are compared, of a model's states."""
    body = states.body
    return np.concatenate([body.q, body.v, body.act, states.sensors], axis=1)


def _after_step(m: mujoco.MjModel, data: mujoco.MjData, control: np.ndarray) -> np.ndarray:
    """The numbers (n,) that are compared, after a step of MuJoCo C."""
    data.ctrl[:] = control
    mujoco.mj_step(m, data)
    return np.concatenate([data.qpos, data.qvel, data.act, data.sensordata])


def _differences(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """The differences of numbers, relative to their sizes where these are above 1."""
    gap = np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs))
    return np.where(np.isfinite(gap), gap, np.inf)


def _set_state(data: mujoco.MjData, body: BodyState, time: float) -> None:
    """Set MuJoCo's data to a state of the model at a time (s)."""
    data.qpos[:] = body.q
    data.qvel[:] = body.v
    data.act[:] = body.act
    data.time = time
    data.qacc_warmstart[:] = body.warm if body.warm.size else 0.0


def _acting_constraints(m: mujoco.MjModel, data: mujoco.MjData) -> str:
    """The constraints that act in C at the beginning of the step that `data` has made."""
    pairs = [tuple(map(int, contact.geom)) for contact in data.contact if contact.efc_address >= 0]
    if pairs:
        others = [words for pair in pairs if (words := contact_words(m, *pair, same=False))]
        return next(iter(others), "") or contact_words(m, *pairs[0])
    rows = {
        mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT: ("jnt", "the limit of "),
        mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON: ("tendon", "the limit of "),
        mujoco.mjtConstraint.mjCNSTR_EQUALITY: ("eq", ""),
        mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF: ("dof", "the friction of "),
        mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON: ("tendon", "the friction of "),
    }
    for kind, number in zip(data.efc_type.tolist(), data.efc_id.tolist(), strict=True):
        if kind in rows:
            owner, words = rows[kind]
            return words + named(m, owner, int(number))
    driven = [named(m, "actuator", i) for i in range(m.nu)]
    return "the motion without contacts and limits" + (f", or {', '.join(driven[:3])}" if driven else "")


def _element(m: mujoco.MjModel, i: int) -> tuple[str, str]:
    """The coordinate and the element of a compared number."""
    if i < m.nq:
        return f"qpos[{i}]", named(m, "jnt", int(np.flatnonzero(m.jnt_qposadr <= i)[-1]))
    i -= m.nq
    if i < m.nv:
        return f"qvel[{i}]", named(m, "dof", i)
    i -= m.nv
    if i < m.na:
        owner = np.flatnonzero((m.actuator_actadr >= 0) & (m.actuator_actadr <= i))[-1]
        return f"act[{i}]", named(m, "actuator", int(owner))
    i -= m.na
    return f"sensordata[{i}]", named(m, "sensor", _sensor_of(m, i))


def _sensor_of(m: mujoco.MjModel, i: int) -> int:
    """The sensor that gives a number of `sensordata`."""
    return int(np.flatnonzero(m.sensor_adr <= i)[-1])
