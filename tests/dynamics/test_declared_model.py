"""Declared models: their members of the contract, and the times of their events."""

from __future__ import annotations

import dataclasses
import pickle
import re
import types
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep import DeclaredModel, diffusion, event, mode, observable, parameter, signal, variable
from gaitsweep.column_meanings import COLUMNS
from gaitsweep.contract import Quantity
from gaitsweep.dynamics.declaration_faults import OF_TRACES, faults_of_quantity
from gaitsweep.engine.recorders.recordings import CrossingRecorder
from gaitsweep.examples.compass_walker import CompassWalker
from gaitsweep.examples.hopper import Hopper
from gaitsweep.kinds import RUN_KINDS
from gaitsweep.models.conformity import fault, variables_without_rate
from gaitsweep.models.value_faults import _AtStarts, faults, surface_value
from gaitsweep.skeleton import LimbLook
from gaitsweep.status import Status
from smooth_oscillators import VanDerPol
from tests.support.sweeping import run_rows, scalars


@dataclasses.dataclass(frozen=True)
class Balls(DeclaredModel):
    """N balls that bounce without loss on floors of their own; the section is the first one's bounce."""

    N: int = 2

    g = parameter("m/s2", "gravity", 10.0, low=0.0, symbol="g")
    floor = parameter("m", "height of the floor below ball", 0.0, count="N")
    z = variable("m", "height of ball", (1.0, "2*g/10"), count="N", low=0.0, symbol="z")
    v = variable("m/s", "speed of ball", count="N", observed=True)
    angle = variable("rad", "angle", 7.0, circular=True)
    bounces = mode(0, "bounces so far", count="N")
    parity = mode(False, "whether ball 1 has bounced an odd number of times")

    def flow(self, p, s):
        return {"z": s.v, "v": jnp.full(self.N, -p.g), "angle": jnp.asarray(0.5)}

    @event("ball 1 bounces", section=True)
    def first(self, p, s):
        return p.floor[0] - s.z[0]

    @first.jump
    def bounce_first(self, p, s):
        return _bounced(s, 0).replace(parity=~s.parity)

    @event("ball 2 bounces")
    def second(self, p, s):
        return p.floor[1] - s.z[1]

    @second.jump
    def bounce_second(self, p, s):
        return _bounced(s, 1)

    @observable("J", "energy of a mass of 1 kg, both balls", signal=True)
    def energy(self, p, s):
        return jnp.sum(0.5 * s.v**2 + p.g * s.z)

    @signal("1", "whether it is odd")
    def odd(self, p, s):
        return s.parity

    def period(self, p):
        return jnp.sqrt(8.0 / p.g)


def _bounced(s, i):
    here = jnp.arange(s.v.size) == i
    return s.replace(v=jnp.where(here, jnp.abs(s.v), s.v), bounces=s.bounces + here.astype(int))


def test_the_contracts_quantities_follow_from_the_declarations() -> None:
    model = Balls()
    assert fault(model) is None
    assert [q.name for q in model.parameters] == ["g", "floor_1", "floor_2"]
    starts = {q.name: (q.default, q.meaning, q.low) for q in model.initial_conditions}
    assert starts["z_1_0"] == (1.0, "height of ball 1 at the start", 0.0)
    assert starts["z_2_0"][0] == "2*g/10"
    assert list(starts) == ["z_1_0", "z_2_0", "angle_0", "bounces_1_0", "bounces_2_0", "parity_0"]
    assert [q.name for q in model.observables] == ["z_1", "z_2", "v_1", "v_2", "angle", "energy"]
    assert [q.name for q in model.signals] == ["z_1", "z_2", "v_1", "v_2", "angle", "energy", "odd"]
    assert model.observables[0].low == -np.inf, "bounds are those of the start"
    assert model.observables[0].symbol == "z_{1}"
    assert (model.name, model.gaits) == ("balls", ("none",))
    assert model.guard_names[::2] == ("ball 1 bounces", "ball 2 bounces")
    assert [q.name for q in Balls(N=3).parameters] == ["g", "floor_1", "floor_2", "floor_3"]


@pytest.mark.slow
def test_states_are_pytrees_that_keep_types_and_shapes() -> None:
    model = Balls()
    p = scalars(model)
    s = model.init(p, jax.tree.map(jnp.asarray, {"z_1_0": 1.0, "z_2_0": 2.0, "angle_0": 7.0}))
    assert s.bounces.dtype == jnp.int64
    assert s.parity.dtype == bool
    assert s.replace(v=1).v.tolist() == [1.0, 1.0], "a number fills an array"
    assert s.replace(bounces=2).bounces.dtype == jnp.int64
    assert float(model.observe(p, s)["angle"]) == pytest.approx(7.0 - 2.0 * np.pi)
    with pytest.raises(TypeError, match=r"Balls\.State has no field bounced; did you mean bounces"):
        s.replace(bounced=1.0)
    with pytest.raises(AttributeError, match=r"Balls\.State has no field angel; did you mean angle"):
        _ = s.angel
    with pytest.raises(AttributeError, match=r"Balls\.Params has no field flor; did you mean floor"):
        _ = p.flor
    assert not hasattr(s, "__array__")
    again = pickle.loads(pickle.dumps(s))
    assert type(again) is type(s) is Balls.State
    assert jax.tree.all(jax.tree.map(jnp.array_equal, again, s))


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["xla", "kernel"])
def test_bounces_happen_at_their_times(engine: str) -> None:
    """A ball from height h falls for (2 h/g)^(1/2) and comes back after twice that."""
    rows = {"z_1_0": [1.0, 1.0, 3.0], "z_2_0": [1.0, 0.3, 0.2], "angle_0": 0.0}
    result = run_rows(Balls(), CrossingRecorder(Balls(), 5), rows, engine=engine)
    assert set(result.status.tolist()) == {Status.complete}
    t = result.samples.reshape(3, 6, -1)[:, 1:, 1]
    fall = np.sqrt(2.0 * np.array(rows["z_1_0"]) / 10.0)
    np.testing.assert_allclose(t, fall[:, None] * (2.0 * np.arange(5) + 1.0), rtol=0, atol=1e-9)


class Drum(DeclaredModel):
    """A point that turns on a circle; events of each kind as it comes over the height h."""

    h = parameter("1", "height", 0.5)
    x = variable("1", "place across", 1.0)
    y = variable("1", "place upwards", 0.0)
    up = mode(False, "whether it was met during odd turns")
    turns = mode(0, "turns")

    def flow(self, p, s):
        return {"x": -s.y, "y": s.x}

    @event("over the height", section=True)
    def over(self, p, s):
        return s.y - p.h * (s.x**2 + s.y**2)  # no plane, and beyond it at once where y_0 > h

    @over.jump
    def count(self, p, s):
        return s.replace(turns=s.turns + 1, up=(s.turns + 1) % 2 == 1)

    @event("right of the middle in odd turns", during=lambda s: s.up, rising=False)
    def right(self, p, s):
        return s.x

    @right.jump
    def met(self, p, s):
        return s.replace(up=False)

    def period(self, p):
        return 2.0 * jnp.pi + 0.0 * p.h


@pytest.mark.parametrize("angle", [0.0, np.pi / 6, 1.0, 3.0])
def test_guards_fire_upwards_and_are_armed_below_zero(angle: float) -> None:
    """On the surface, within rounding, and beyond it no event happens; moving below it arms the event."""
    model = Drum()
    p = scalars(model)
    s = model.init(p, {"x_0": np.cos(angle), "y_0": np.sin(angle)})
    fired = model.guards(p, s) >= 0.0
    assert bool(s.arming.armed[0]) == (np.sin(angle) < 0.5 - 1e-9)
    assert not fired[0]
    assert not fired[2], "its mode does not hold yet"
    below = s.replace(x=1.0, y=-0.1)
    armed = model.jump(p, below, model.guards(p, below) >= 0.0)
    beyond = armed.replace(x=0.8, y=0.6)
    fired = model.guards(p, beyond) >= 0.0
    assert fired.tolist() == [True, False, False]
    assert bool(model.section(p, beyond, fired))
    after = model.jump(p, beyond, fired)
    assert (int(after.turns), bool(after.up), bool(after.arming.armed[0])) == (1, True, False)
    # the second event is already beyond its surface where its mode begins to hold: it follows at once
    chained = model.guards(p, after) >= 0.0
    assert chained.tolist() == [False, False, True]
    assert not bool(model.section(p, after, chained))
    assert not bool(model.jump(p, after, chained).up)


class Jumper(Hopper):
    """The shipped hopper without a lower limit of its push, with which its nominal period does not vanish."""

    push = parameter("m/s", "speed that the leg adds at most", 0.0, low=0.0)

    def period(self, p):
        return 0.5


@pytest.mark.parametrize("launch", [0.01, 1.0, 2.0])
def test_accumulating_bounces_end_the_row(launch: float) -> None:
    """They accumulate at 2 v / (g (1 - e)); the body must not fall through the ground."""
    end = gs.sweep(Jumper(), launch_0=launch, push=0.0, run=gs.FixedTime(duration=5)).table.iloc[0]
    assert (end["status"], end["stalled_by"]) == ("event_stall", "foot lands")
    p = scalars(Jumper())
    expected = 2.0 * launch / float(p.g * (1.0 - p.restitution))
    assert end["t_end"] == pytest.approx(expected, rel=1e-4)


class Ground(DeclaredModel):
    """A ball on a floor at height 0."""

    g = parameter("m/s2", "gravity", 10.0)
    z = variable("m", "height", 1.0)
    v = variable("m/s", "speed", 0.0)

    def flow(self, p, s):
        return {"z": s.v, "v": -p.g}

    @event("lands", section=True)
    def lands(self, p, s):
        return -s.z

    @lands.jump
    def bounce(self, p, s):
        return s.replace(z=0.0, v=jnp.abs(s.v))

    def period(self, p):
        return 2.0 * jnp.sqrt(2.0 / p.g)


def test_an_event_of_a_subclass_replaces_that_of_its_base() -> None:
    class Below(Ground):
        @event("lands below", section=True)
        def lands(self, p, s):
            return -0.5 - s.z

        @lands.jump
        def bounce_below(self, p, s):
            return s.replace(z=-0.5, v=jnp.abs(s.v))

    class Falls(Ground):
        lands = None  # pyright: ignore[reportAssignmentType] (a base's event is removed so)

        @event("ten below", section=True)
        def deep(self, p, s):
            return -10.0 - s.z

    assert [declared_event.name for declared_event in Below.declarations.events] == ["lands below"]
    assert [declared_event.name for declared_event in Falls.declarations.events] == ["ten below"]
    lowest = gs.simulate(Below, duration=1.0, every=0.01)["z"].to_numpy(float).min()
    assert -0.5 <= lowest < -0.45  # 5 m/s at the floor: samples lie at most 5 cm apart


def test_a_subclass_cannot_redefine_a_jump_alone() -> None:
    with pytest.raises(TypeError, match="bounce, the name of the jump of lands"):
        type("Other", (Ground,), {"bounce": lambda self, p, s: s})


@pytest.mark.parametrize("name", ["lands", "g", "z"])
def test_a_subclass_cannot_replace_a_declaration_by_a_plain_member(name: str) -> None:
    """The event, parameter or variable would be gone without a word."""
    with pytest.raises(TypeError, match=rf"Other defines {name}, .* or write {name} = None to remove it"):
        type("Other", (Ground,), {name: lambda self, p, s: -s.z})


def test_a_model_has_the_declarations_of_all_its_bases() -> None:
    class Wind:
        wind = parameter("m/s2", "push of the wind", 0.5)

    class Windy(Ground, Wind):
        def flow(self, p, s):
            return {"z": s.v, "v": p.wind - p.g}

    assert {quantity.name for quantity in Windy().parameters} >= {"g", "wind"}
    assert fault(Windy()) is None


def _flows(**rates):
    return {"flow": lambda self, p, s: {"z": s.v, "v": -p.g} | {k: rate(s) for k, rate in rates.items()}}


def _diffuses(**intensities):
    return diffusion(lambda self, p, s: {k: jnp.asarray(value) for k, value in intensities.items()})


def _jumps(effect):
    """An event "is high" with this jump."""
    high = event("is high")(lambda self, p, s: s.z - 2.0)
    high.jump(effect)
    return high


FAULTS = {
    "rate of v as whole numbers": _flows(v=lambda s: -1),
    "rate of v as complex numbers": _flows(v=lambda s: s.z + 0j),
    "rate of v in float32": _flows(v=lambda s: s.z.astype(jnp.float32)),
    "no rate of z, and no jump changes it": {
        "flow": lambda self, p, s: {"v": -p.g},
        "lands": None,
        "tick": event("it ticks", section=True)(lambda self, p, s: s.v),
    },
    "flow returns a rate of w, which has held=True": {
        "w": variable("m", "a height that is kept", held=True),
        **_flows(w=lambda s: 0.0),
    },
    "but its function flow returns tuple, but": {"flow": lambda self, p, s: (s.v, -p.g)},
    "but its function flow returns nothing, but": {"flow": lambda self, p, s: None},
    "flow returns a rate of z with shape \\(2,\\), but": _flows(z=lambda s: jnp.stack([s.v, s.v])),
    "flow returns a rate of z as tuple, but must return one array": _flows(z=lambda s: (s.v, s.v)),
    "diffusion returns an intensity of w, which is not a field": {"noise": _diffuses(w=0.1)},
    "diffusion returns an intensity of n, which is a mode": {
        "n": mode(0, "a number"),
        "noise": _diffuses(n=0.1),
    },
    "diffusion returns an intensity of z with shape \\(2,\\), but": {"noise": _diffuses(z=np.ones(2))},
    "but its function flow raises TracerBool.* Use jnp.where": _flows(v=lambda s: -1.0 if s.z > 0 else 1.0),
    "the jump of 'is high' returns nothing": {"high": _jumps(lambda self, p, s: None)},
    "the jump of 'is high' raises .* no field w": {"high": _jumps(lambda self, p, s: s.replace(w=0.0))},
    "the jump of 'is high' raises .* z is given complex": {
        "high": _jumps(lambda self, p, s: s.replace(z=1j))
    },
    "period returns whole numbers": {"period": lambda self, p: 3},
    "signal z_0 has the name of a": {
        "z_0": variable("m", "a variable named as the start of z", 1.0),
        **_flows(z_0=lambda s: 0.0),
    },
    "observable r_1 has the name of a parameter": {
        "r_1": parameter("1", "a parameter named as the first of r", 1.0),
        "r": observable("1", "r", count=2)(lambda self, p, s: jnp.stack([s.z, s.v])),
    },
    r"a gait named '\$\\\\bm{a}\$', which Matplotlib cannot set": {"gaits": (r"$\bm{a}$", "b")},
    "a gait named not settled, the outcome of rows without a gait": {"gaits": ("walk", "not settled")},
    r"a limb named '\$\\\\bm{l}\$', which": {"limbs": property(lambda self: (LimbLook(r"$\bm{l}$"),))},
    r"an event named '\$\\\\bm{e}\$', which": {"high": event(r"$\bm{e}$")(lambda self, p, s: s.z - 2.0)},
    "'it is high' returns booleans": {"high": event("it is high")(lambda self, p, s: s.z > 2.0)},
    "'it is one' returns whole numbers": {"one": event("it is one")(lambda self, p, s: jnp.asarray(1))},
    "jump returns z with type int64": {
        "jump": lambda self, p, s, fired: dataclasses.replace(s, z=jnp.where(fired[0], 0, s.z.astype(int)))
    },
    "gait as real numbers": {"label": lambda self, p, at: {"gait": at["z"]}},
    r"symbol '\\\\bm": {"k": parameter("1", "k", 1.0, symbol=r"\bm{k}")},
    "unit": {"k": parameter(r"$\bm{k}$", "k", 1.0)},
}


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, True])
def test_a_variable_that_only_events_change_is_remarked_unless_it_is_held(held: bool) -> None:
    kept = {"w": variable("m", "a height", held=held), "high": _jumps(lambda self, p, s: s.replace(w=s.z))}
    model = type("Mine", (Ground,), kept)()
    assert fault(model) is None
    assert variables_without_rate(model) == (() if held else ("w",))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        gs.sweep(model, g=[9.0, 10.0], run=gs.Settle(max_cycles=2), verify=0)
    sentence = "flow returns no rate of w, so that only events change it: return its rate, or declare"
    assert any(sentence in str(each.message) for each in said) != held


@pytest.mark.parametrize("words", FAULTS)
def test_impossible_declarations_are_refused_by_name(words: str) -> None:
    model = type("Mine", (Ground,), FAULTS[words])
    assert re.search(words, fault(model()) or "")
    with pytest.raises(gs.UserError, match=words):
        gs.sweep(model, g=[9.0, 10.0])


# What declarations alone show is refused when the class is made.
REFUSED_AT_ONCE = {
    "declares z_0 twice": {"z_0": parameter("m", "another height", 1.0)},
    "declares z_1_0 twice": {"z_1": variable("m", "height", 1.0), "z": variable("m", "z", 1.0, count=2)},
    "bounds that allow no value": {"k": parameter("1", "k", 0.5, low=1.0, high=0.0)},
    "default 5, which must be within": {"k": parameter("1", "k", 5.0, low=0.0, high=1.0)},
    "default nan": {"k": parameter("1", "k", float("nan"))},
    "default inf, which must be a finite": {"k": parameter("1", "k", float("inf"))},
    "y_0 has the default 5": {"y": variable("1", "y", 5.0, high=1.0)},
    "scale 0": {"y": variable("1", "y", 0.0, scale=0.0)},
    "scale nan": {"y": variable("1", "y", 0.0, scale=float("nan"))},
    "k has no unit": {"k": parameter("", "k", 0.5)},
    r'e, which means something else .* write e_, or another name with symbol="e"': {
        "e": parameter("1", "restitution", 0.5)
    },
    "quantity sample, which means": {"sample": parameter("1", "sample", 0.5)},
    'quantity status, but tables have a column status: write status_, or another name with symbol="status"': {
        "status": signal("1", "status")(lambda self, p, s: s.z)
    },
    "quantity t, but tables have a column t:": {"t": variable("s", "time")},
    "quantity depth, but tables have a column depth:": {"depth": parameter("m", "depth", 1.0)},
    "quantity found, but tables have a column found:": {"found": variable("m", "way", 1.0, signal=False)},
    "quantity t_lands, but tables have a column t_lands": {"t_lands": parameter("s", "time", 1.0)},
    "quantity z, but tables have a column z_end": {"z_end": parameter("m", "last height", 1.0)},
    r'count="M", which is not a field of its structure\. Allowed: N': {
        "__annotations__": {"N": "int"},
        "k": parameter("1", "k", 1.0, count="M"),
    },
    "declares the diffusions noise and gusts: only one is allowed": {
        "noise": diffusion(lambda self, p, s: {"z": 0.1}),
        "gusts": diffusion(lambda self, p, s: {"v": 0.1}),
    },
    "z has 2 start values, but 3 numbers": {"z": variable("m", "z", (1.0, 2.0), count=3)},
}


@pytest.mark.parametrize("words", REFUSED_AT_ONCE)
def test_wrong_declarations_are_refused_when_the_class_is_defined(words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        type("Mine", (Ground,), REFUSED_AT_ONCE[words])


def test_defaults_may_be_numbers_of_numpy() -> None:
    whole: Any = np.int64(3)
    single: Any = np.float32(0.5)
    several: Any = np.array([1, 2])
    of_jax: Any = jnp.asarray(0.5)
    flag: Any = np.True_
    assert [type(parameter("1", "k", value).quantity.default) for value in (whole, single)] == [int, float]
    of_quantity = Quantity("k", "1", "k", whole, high=1.0)  # of a model written without declarations
    assert "default 3, which must be within" in next(faults_of_quantity(of_quantity, start=False))
    assert parameter("1", "k", several, count=2).defaults == (1, 2)
    assert variable("1", "y", of_jax).start == 0.5
    assert mode(flag, "down").start is True


@pytest.mark.parametrize("start", [0.5, "down", (0, 0.5), None])
def test_a_mode_begins_with_a_bool_or_a_whole_number(start: Any) -> None:
    with pytest.raises(TypeError, match="must have a bool or a whole number"):
        mode(start, "down")


@pytest.mark.parametrize("count", [0, -1, 2.0, True])
def test_a_count_is_a_number_of_components(count: object) -> None:
    with pytest.raises(TypeError, match=r"allowed are whole numbers from 1 on, and the name of a field"):
        mode(False, "down", count=count)  # type: ignore[arg-type]


def test_names_of_columns_are_those_of_the_tables() -> None:
    """A column that a run kind adds is one that no quantity may have, and the page on models lists it."""
    model = Ground()
    own = {f"{q.name}{end}" for q in (*model.observables, *model.signals) for end in ("", "_end", "_n")}
    along = {"parameter": "g", "path": [9.0, 10.0]}
    trace = gs.Trace(duration=1.0, every=1.0)
    runs = (
        gs.Settle(),
        gs.FixedTime(duration=1.0),
        RUN_KINDS["perturb"](push=["v"]),
        gs.ReturnMap(crossings=1),
        trace,
        gs.Ramp(**along, rate=0.1),
        gs.Staircase(**along, step=0.1, dwell=10.0),
        gs.Continuation(**along, crossing=True),
        gs.Continuation(**along, stationary=True),
        RUN_KINDS["atlas"](**along, ranges={"z_0": [0.0, 1.0]}),
    )
    times = {f"t_{name.replace(' ', '_')}" for name in model.guard_names}  # of events, in an atlas
    columns = {column.name for run in runs for column in run.all_columns(model)} - own - times - {"g"}
    assert columns | {"row"} == set(COLUMNS)
    assert {column.name for column in trace.all_columns(model)} - own < set(OF_TRACES)
    page = (Path(__file__).parents[2] / "docs/own_model.md").read_text()
    assert ", ".join(f"`{name}`" for name in sorted(COLUMNS)) in " ".join(page.split())


def test_a_paper_may_call_its_parameters_e_and_lambda() -> None:
    class Thrown(Ground):
        e_ = parameter("1", "restitution", 0.5)
        lambda_ = parameter("1", "wavelength", 2.0, count=2)
        ratio = parameter("1", "restitution", 0.5, symbol="e")

    symbols = {q.name: q.symbol for q in Thrown().parameters}
    assert symbols == {
        "g": "", "e_": "e", "lambda_1": r"\lambda_{1}", "lambda_2": r"\lambda_{2}", "ratio": "e"
    }  # fmt: skip
    params = {"lambda_2": "2*e_"}
    table = gs.sweep(Thrown, e_=[0.25, 0.5], params=params, run=gs.FixedTime(duration=0.1)).table
    assert table["e_"].tolist() == [0.25, 0.5]
    with pytest.raises(gs.UserError, match="did you mean e_"):
        gs.sweep(Thrown, e=[0.25, 0.5])


@pytest.mark.slow
def test_an_event_that_its_jump_does_not_end_happens_without_end() -> None:
    class Held(Ground):
        @event("too high", rising=False, during=lambda s: s.v > -1e9)
        def high(self, p, s):
            return s.z - 0.5

        @high.jump
        def pushed(self, p, s):
            return s.replace(v=-jnp.abs(s.v))

    (told,) = faults(Held)
    assert "event 'too high' is not ended by its jump" in told


@pytest.mark.slow
def test_a_start_in_the_middle_between_two_instants_is_no_fault() -> None:
    """Their phase is there zero but for rounding, so that each jump arms the event by what it sees anew."""

    class Ticking(DeclaredModel):
        length = parameter("s", "time between two instants", 1.0)
        x = variable("1", "place", 0.0)
        t = gs.time()
        tick = gs.instants("tick", every=lambda p: p.length, after=-0.5, section=True)

        def flow(self, p, s):
            return {"x": -s.x, "t": 1.0}

        def period(self, p):
            return p.length

    assert faults(Ticking) == []


def test_a_variable_with_a_name_like_that_of_the_arming_is_checked() -> None:
    at_starts: Any = types.SimpleNamespace(state={"arming.level": np.nan, "arming_angle": np.nan})
    own_state: Any = _AtStarts.own_state
    assert list(own_state.fget(at_starts)) == ["arming_angle"]


def test_a_sentence_of_a_model_that_cannot_be_made_ends_once() -> None:
    def fails(self: object) -> None:
        raise ValueError("A foot has no ground.")

    told = "which raises ValueError when it is created: A foot has no ground."
    assert faults(type("Mine", (Ground,), {"limbs": property(fails)})) == [told]


def test_complex_rates_are_refused_without_a_warning_of_jax(recwarn: pytest.WarningsRecorder) -> None:
    assert "complex numbers" in (fault(type("Mine", (Ground,), _flows(v=lambda s: s.z + 1j))()) or "")
    assert not recwarn.list


def test_a_variable_that_a_jump_alone_moves_needs_no_rate() -> None:
    class Marks(Ground):
        last = variable("m/s", "speed of the last landing", 0.0)

        @event("lands", section=True)
        def lands(self, p, s):
            return -s.z

        @lands.jump
        def bounce(self, p, s):
            return s.replace(z=0.0, v=jnp.abs(s.v), last=jnp.abs(s.v))

    assert fault(Marks()) is None


def test_a_quantity_with_the_name_of_a_column_is_refused() -> None:
    status = Quantity("status", "1", "any")  # of a model that writes this member by hand
    members = {"signals": property(lambda self: (status,)), "signal": lambda self, p, s: {"status": s.z}}
    model = type("Mine", (Ground,), members)
    with pytest.raises(gs.UserError, match="a quantity status, but the table of trace has"):
        gs.simulate(model, duration=1.0)


def test_circular_readings_are_recorded_within_a_turn() -> None:
    class Turns(Ground):
        @observable("rad", "an angle", circular=True, signal=True)
        def angle(self, p, s):
            return 7.0 * s.z

    model = Turns()
    params = scalars(model)
    state = model.init(params, {"z_0": jnp.asarray(-1.0), "v_0": jnp.asarray(0.0)})
    assert float(model.observe(params, state)["angle"]) == pytest.approx(4.0 * np.pi - 7.0)
    assert float(model.signal(params, state)["angle"]) == pytest.approx(4.0 * np.pi - 7.0)


def test_starts_beyond_a_surface_are_those_that_the_jump_leaves_there() -> None:
    def beyond(model, **start):
        params = scalars(model)
        state = model.init(params, {name: jnp.asarray(value) for name, value in start.items()})
        return {name: bool(each) for name, each in model.beyond_at_start(params, state).items()}

    assert beyond(Ground(), z_0=-0.1, v_0=0.0) == {"lands": True}
    g = {q.name: np.array([q.default]) for q in Ground().parameters}
    below = surface_value(Ground(), "lands", {**g, "z_0": np.array([-0.1]), "v_0": np.array([0.0])}, 0)
    assert below == pytest.approx(0.1), "the function is -z"
    assert beyond(Ground(), z_0=0.1, v_0=-1.0) == {"lands": False}
    assert beyond(VanDerPol(), x_0=2.0, v_0=1.0) == {}  # a section without a jump
    started = {"stance_0": -0.2187, "stance_rate_0": 1.0918, "swing_rate_0": 0.3772}
    assert beyond(CompassWalker(), **started) == {"heel strikes": False}  # it starts just after its section


def test_a_subclass_may_define_declared_members() -> None:
    class Slower(Drum):
        h = parameter("1", "height", 0.25)
        tilt = parameter("rad", "another", 0.0)

        def flow(self, p, s):
            return {"x": -0.5 * s.y, "y": 0.5 * s.x}

    assert [(q.name, q.default) for q in Slower().parameters] == [("h", 0.25), ("tilt", 0.0)]
    assert fault(Slower()) is None
    assert Slower.State is not Drum.State


def test_contradictions_are_refused_in_one_sentence() -> None:
    def made(**members):
        members = {"flow": lambda self, p, s: {}, "period": lambda self, p: 1.0, **members}
        return type("Mine", (DeclaredModel,), members)

    happens = event("it happens")(lambda self, p, s: s.x)
    lands = event("it lands", section=True)(lambda self, p, s: s.x)
    lands.rest(lambda self, p, s: s)
    for members, words in (
        ({"jump": variable("m", "height")}, "Mine declares jump, a name that every model has: rename it"),
        ({"x": variable("m", "x"), "e": happens}, "has events but no section: write section=True"),
        ({"x": variable("m", "x"), "e": lands}, "a rest after the event 'it lands', which has no jump"),
        (
            {"height": variable("m", "x"), "section_coordinates": ("heigth",)},
            "heigth, no variable; did you mean height",
        ),
        ({"x": variable("m", "x"), "section_coordinates": "x"}, "is 'x', but must be a tuple of names"),
        ({"x": variable("m", "x"), "section_coordinates": None}, "is None, but must be a tuple of names"),
    ):
        with pytest.raises(TypeError, match=words):
            made(**members)
    with pytest.raises(TypeError, match="rising=False, so it needs during="):
        event("lands", rising=False)
    interval: Any = 1.0
    with pytest.raises(TypeError, match=r"'kick' have every=1\.0, .*every=lambda p: 1\.0"):
        gs.instants("kick", every=interval)
    with pytest.raises(TypeError, match="'kick' have after= without every="):
        gs.instants("kick", at=[1.0], after=0.5)
    several: Any = np.array([1.0, 2.0])
    assert [gs.instants("kick", at=at).count for at in (several, [3.0])] == [2, 1]
    with pytest.raises(ValueError, match="z has 2 start values, but 3 numbers"):
        _ = Balls(N=3).initial_conditions
    with pytest.raises(ValueError, match="legs has 2 start values, but 3 numbers"):
        made(legs=mode((True, False), "foot is down", count=3))
    with pytest.raises(ValueError, match="masses has 0 defaults, but 3 numbers"):
        made(masses=parameter("kg", "masses", (), count=3))


def test_a_number_in_the_place_of_the_meaning_is_refused() -> None:
    with pytest.raises(TypeError, match=r"The meaning of a declaration is 9\.81, but must be text"):
        parameter("m/s2", 9.81)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"The unit of a declaration is 1\.0, but must be text"):
        variable(1.0, "height")  # type: ignore[arg-type]


@dataclasses.dataclass(frozen=True)
class CountedBalls(Balls):
    """The same balls, whose events and signals are one declaration each."""

    first = None  # pyright: ignore[reportAssignmentType] (a base's event is removed so)

    @event("ball {} bounces", count="N", section="first")
    def second(self, p, s):
        return p.floor - s.z

    @second.jump
    def bounce_second(self, p, s, i):
        after = s.replace(v=s.v.at[i].set(jnp.abs(s.v[i])), bounces=s.bounces.at[i].add(1))
        return after.replace(parity=~s.parity) if i == 0 else after

    @signal("m", "height over the floor of ball", count="N")
    def over(self, p, s):
        return s.z - p.floor


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["xla", "kernel"])
def test_events_of_one_declaration_are_those_of_several(engine: str) -> None:
    """Fails if a component jumps with another's number, or closes a cycle that it does not close."""
    rows = {"z_1_0": [1.0, 1.0, 3.0], "z_2_0": [1.0, 0.3, 0.2], "angle_0": 0.0}
    counted, single = (
        run_rows(model, CrossingRecorder(model, 5), rows, engine=engine)
        for model in (CountedBalls(), Balls())
    )
    assert set(counted.status.tolist()) == {Status.complete}
    np.testing.assert_array_equal(counted.samples, single.samples)
    assert fault(CountedBalls()) is None
    assert CountedBalls().guard_names == Balls().guard_names
    assert CountedBalls(N=3).guard_names[::2] == tuple(f"ball {i} bounces" for i in (1, 2, 3))
    assert [q.name for q in CountedBalls(N=3).signals[-3:]] == ["over_1", "over_2", "over_3"]
    p = scalars(model := CountedBalls(), z_2=1.0)
    s = model.init(p, jax.tree.map(jnp.asarray, {"z_1_0": 1.0, "z_2_0": 2.0, "angle_0": 7.0}))
    assert {name: float(v) for name, v in model.signal(p, s).items() if "over" in name} == {
        "over_1": 1.0,
        "over_2": 2.0,
    }


def test_counted_functions_that_return_another_number_are_refused() -> None:
    class ThreeHeights(CountedBalls):
        @signal("m", "height of ball", count="N")
        def over(self, p, s):
            return s.z[:1]

    assert "over has the shape (1,), but its count= asks for 2 numbers" in (fault(ThreeHeights()) or "")

    class OneSurface(CountedBalls):
        @event("ball {} bounces", count="N", section="first")
        def second(self, p, s):
            return s.z[0]

    assert "must return 2 numbers, (2,), as count= says" in (fault(OneSurface()) or "")


class Scuffing(DeclaredModel):
    """A foot that swings in a circle and is lifted as by a saw; it scuffs where it is not lifted enough."""

    omega = parameter("rad/s", "rate of the swing", 2.0, low=0.0)
    rate = parameter("1/s", "rate at which the foot is lifted", 0.37)
    clearance = parameter("1", "share of the lift below which the foot scuffs", 0.5)
    x = variable("1", "place of the foot forwards", 1.0)
    z = variable("1", "height of the foot", 0.0)
    lift = variable("1", "lift of the foot", 0.0)
    scuffs = mode(0, "scuffs so far")

    def flow(self, p, s):
        return {"x": -p.omega * s.z, "z": p.omega * s.x, "lift": p.rate}

    @event("foot scuffs", section=True, direction="falling", when=lambda p, s: s.lift < p.clearance)
    def scuff(self, p, s):
        return s.z

    @scuff.jump
    def scuffed(self, p, s):
        return s.replace(scuffs=s.scuffs + 1)

    @event("lift begins anew")
    def lifted(self, p, s):
        return s.lift - 1.0

    @lifted.jump
    def lowered(self, p, s):
        return s.replace(lift=s.lift - 1.0)

    @observable("1", "scuffs so far")
    def count(self, p, s):
        return s.scuffs

    def period(self, p):
        return 2.0 * jnp.pi / p.omega


class Touching(Scuffing):
    """The same foot, which touches the ground in both directions."""

    @event("foot passes the ground", section=True, direction="both", when=lambda p, s: s.lift < p.clearance)
    def scuff(self, p, s):
        return s.z

    @scuff.jump
    def scuffed(self, p, s):
        return s.replace(scuffs=s.scuffs + 1)


@pytest.mark.parametrize(
    ("engine", "model"),
    [pytest.param("xla", Scuffing(), marks=pytest.mark.slow), ("kernel", Scuffing()), ("kernel", Touching())],
)
def test_a_condition_on_variables_is_judged_at_the_located_crossing(engine: str, model: Scuffing) -> None:
    """The height is sin(omega t), the lift the fractional part of rate t: times of scuffs are known.

    Events are located to 1e-12 of the period, and tolerances of the steps are 1e-8: 1e-6 s would miss a
    condition that is judged at the end of a step, or a crossing that is taken up late.
    """
    rates = np.array([0.37, 0.11, 0.83])
    result = run_rows(
        model, CrossingRecorder(model, 6), {"x_0": np.ones(3)}, params={"rate": rates}, engine=engine
    )
    assert set(result.status.tolist()) == {Status.complete}
    samples = result.samples.reshape(3, 7, -1)[:, 1:]
    falls = np.pi * (np.arange(1, 200) if isinstance(model, Touching) else np.arange(1, 200, 2)) / 2.0
    for row, rate in enumerate(rates):
        low = (rate * falls) % 1.0 < 0.5
        assert 0.2 < low[:10].mean() < 1.0, "some crossings are passed over"
        np.testing.assert_allclose(samples[row, :, 1], falls[low][:6], rtol=0, atol=1e-6)
    counts = [q.name for q in model.observables].index("count") - len(model.observables)
    assert samples[0, :, counts].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_conditions_and_directions_that_are_none_are_refused() -> None:
    with pytest.raises(TypeError, match="direction='down': allowed are rising, falling, both"):
        event("lands", direction="down")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="rising=False, so it has no crossing for when="):
        event("lands", rising=False, during=lambda s: s.down, when=lambda p, s: s.x > 0.0)

    class Numbers(Scuffing):
        @event("foot scuffs", section=True, when=lambda p, s: s.lift)
        def scuff(self, p, s):
            return s.z

    assert "when= of the event 'foot scuffs' returns real numbers" in (fault(Numbers()) or "")
