"""Caches of compiled programs are keyed on everything that a model computes with."""

from __future__ import annotations

import dataclasses
import enum
import functools
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gaitsweep as gs
from gaitsweep.analysis.continuation.plain_map import PlainMap
from gaitsweep.engine.content import cached_by_content, content_of, is_user_module
from gaitsweep.engine.poincare.map_derivatives import LevelMap
from gaitsweep.engine.poincare.maps import Map
from gaitsweep.engine.poincare.return_map import BatchedReturnMap

GAIN = 1.0
TABLE = np.array([1.0, 2.0])
SETTINGS = {"gain": [1.0]}
UNRELATED = 1.0
own = types.ModuleType("own_constants")  # as a module of the user's that is edited
own.K = 1.0  # type: ignore[attr-defined]
sys.modules["own_constants"] = own


class Force:
    """An object with an attribute."""

    def __init__(self) -> None:
        self.k = 1.0

    def __call__(self, x: jax.Array) -> jax.Array:
        return self.k * x


force = Force()


class Kilograms(float):
    """A number of a class of its own."""


class Weights(list[float]):
    """A list with an attribute."""

    unit = 1.0


class Gains(NamedTuple):
    """A named tuple with a method."""

    k: float = 1.0

    def doubled(self) -> float:
        return 2.0 * self.k


class Stiffness(enum.Enum):
    """A choice among numbers."""

    CHOSEN = 1.0


class Scaled(type):
    """A class of classes with an attribute."""

    scale = 1.0


class Scales(metaclass=Scaled):
    """A class with the attributes of its class."""


CLASSES: dict[str, tuple[Any, Any, str]] = {
    "number": (Kilograms(1.0), Kilograms(4.0), ""),
    "named tuple": (Gains(), Gains(), "doubled"),
    "list": (Weights([1.0]), Weights([1.0]), "unit"),
    "enumeration": (Stiffness.CHOSEN, enum.Enum("Stiffness", {"CHOSEN": 4.0}, module=__name__).CHOSEN, ""),  # type: ignore[attr-defined]
    "class of a class": (Scales, Scales, "scale"),
}
of_class: Any = None


class Calls:
    """An object with a method that calls a function."""

    def __init__(self, function: Callable[[], float]) -> None:
        self.function = function

    def value(self) -> float:
        return self.function()


def helper(x: jax.Array, exponent: float = 1.0) -> jax.Array:
    return GAIN * x**exponent


@jax.jit
def jitted(x: jax.Array) -> jax.Array:
    return GAIN * x


def body(x: jax.Array, _: Any) -> tuple[jax.Array, None]:
    return GAIN * x, None


def enclosed(k: float) -> tuple[Callable[[jax.Array], jax.Array], Callable[[float], None]]:
    def multiply(x: jax.Array) -> jax.Array:
        return k * x

    def change(to: float) -> None:
        nonlocal k
        k = to

    return multiply, change


multiply, change = enclosed(1.0)


class Spring(gs.DeclaredModel):
    """A spring whose force comes from all over the place."""

    q = gs.parameter("1/s", "rate", 1.0)
    x = gs.variable("m", "position", 1.0)
    v = gs.variable("m/s", "speed", 0.0)
    ATTRIBUTE = 1.0

    def stiffness(self, x: jax.Array) -> jax.Array:
        return self.ATTRIBUTE * helper(multiply(force(jitted(x))))

    def flow(self, p, s):
        along = own.K * SETTINGS["gain"][0] * TABLE[0] * self.stiffness(s.x)  # type: ignore[attr-defined]
        return {"x": s.v, "v": -(p.q**2) * along}

    @gs.event("v rises through 0", section=True)
    def turns(self, p, s):
        return s.v

    def period(self, p):
        return 2.0 * jnp.pi / p.q


def _global(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(sys.modules[__name__], "GAIN", 4.0)


CHANGES: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
    "global": _global,
    "closure": lambda _: change(4.0),
    "class attribute": lambda patch: patch.setattr(Spring, "ATTRIBUTE", 4.0),
    "method": lambda patch: patch.setattr(Spring, "stiffness", lambda self, x: 4.0 * x),
    "default of a function": lambda patch: patch.setattr(helper, "__defaults__", (2.0,)),
    "element of an array": lambda _: TABLE.put(0, 4.0),
    "element of a list": lambda patch: patch.setitem(SETTINGS, "gain", [4.0]),
    "attribute of a module": lambda patch: patch.setattr(own, "K", 4.0),
    "attribute of an object": lambda patch: patch.setattr(force, "k", 4.0),
}


@pytest.mark.parametrize("change_it", CHANGES.values(), ids=CHANGES)
def test_content_includes_what_functions_read(
    change_it: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content_of(Spring())
    change_it(monkeypatch)
    assert content_of(Spring()) != before
    monkeypatch.undo()
    change(1.0)
    TABLE.put(0, 1.0)
    assert content_of(Spring()) == before


@pytest.mark.parametrize("name", CLASSES)
def test_content_includes_what_a_class_of_ones_own_adds(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def function() -> Any:
        return of_class

    before, after, attribute = CLASSES[name]
    monkeypatch.setattr(sys.modules[__name__], "of_class", before)
    content = content_of(function)
    assert content_of(function) == content
    monkeypatch.setattr(sys.modules[__name__], "of_class", after)
    if attribute:
        kind = type(after) if not isinstance(after, Scaled) else Scaled
        monkeypatch.setattr(kind, attribute, 4.0)
    assert content_of(function) != content


def test_content_of_modules_that_import_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    def function() -> Any:
        return own.beside.K, own.beside.own  # type: ignore[attr-defined]

    beside = types.ModuleType("own_beside")
    beside.K, beside.own = 1.0, own  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "own_beside", beside)
    monkeypatch.setattr(own, "beside", beside, raising=False)
    before = content_of(function)
    monkeypatch.setattr(beside, "K", 4.0)
    assert content_of(function) != before


def test_content_includes_a_module_that_a_function_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    def function() -> Any:
        import own_constants  # type: ignore[import-not-found]

        return own_constants.K

    before = content_of(function)
    monkeypatch.setattr(own, "K", 4.0)
    assert content_of(function) != before


def test_content_includes_a_module_of_a_closure(monkeypatch: pytest.MonkeyPatch) -> None:
    def enclosing(module: Any) -> Callable[[], float]:
        return lambda: module.K

    function = enclosing(own)
    before = content_of(function)
    monkeypatch.setattr(own, "K", 4.0)
    assert content_of(function) != before


def test_content_excludes_what_no_function_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    before = content_of(Spring())
    monkeypatch.setattr(sys.modules[__name__], "UNRELATED", 4.0)
    assert content_of(Spring()) == before


def test_a_cell_that_is_run_again_unchanged_is_the_same_content() -> None:
    def cell() -> type[gs.DeclaredModel]:
        class Again(Spring):
            def period(self, p):
                return 1.0 / p.q

        return Again

    first, second = cell(), cell()
    assert first is not second
    assert content_of(first()) == content_of(second())


def test_functions_are_called_again_for_changed_content_only(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    @cached_by_content(maxsize=8)
    def compiled(model: gs.DeclaredModel, size: int = 1) -> float:
        calls.append(size)
        return GAIN

    assert [compiled(Spring()), compiled(Spring()), compiled(Spring(), size=2)] == [1.0, 1.0, 1.0]
    assert compiled(model=Spring(), size=3) == 1.0
    assert calls == [1, 2, 3]
    _global(monkeypatch)
    assert compiled(Spring()) == compiled(model=Spring(), size=3) == 4.0
    monkeypatch.undo()
    assert compiled(Spring()) == compiled(model=Spring(), size=3) == 1.0
    assert calls == [1, 2, 3, 1, 3]


@dataclasses.dataclass(frozen=True)
class Loops(Spring):
    """A spring whose force is a loop over a function of the module."""

    def flow(self, p, s):
        return {"x": s.v, "v": -(p.q**2) * jax.lax.scan(body, s.x, None, length=1)[0]}


@pytest.mark.slow
@pytest.mark.parametrize(("model", "engine"), [(Spring, "kernel"), (Loops, "xla")])
def test_a_sweep_after_a_change_has_the_numbers_of_now(
    model: type[gs.DeclaredModel], engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A period of 2 pi / (q sqrt(k)); jitted functions and loops that JAX has traced are traced again."""

    def turn() -> float:
        run = gs.ReturnMap(crossings=1)
        return float(gs.sweep(model(), run=run, q=[1.0], verify=0, engine=engine).table.t.iloc[-1])

    assert turn() == pytest.approx(np.pi, abs=1e-6)
    _global(monkeypatch)  # which Spring reads twice
    assert turn() == pytest.approx(np.pi / (4.0 if model is Spring else 2.0), abs=1e-6)
    monkeypatch.undo()
    assert turn() == pytest.approx(np.pi, abs=1e-6)


@pytest.mark.slow
def test_a_return_map_and_a_simulation_follow_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    mapping = gs.return_map(Loops())
    along = mapping.mapping.images(mapping.settled(cycles=1), {}).observed["time"][0]
    assert along == pytest.approx(2.0 * np.pi, abs=1e-6)
    end = gs.simulate(Loops(), duration=np.pi, every=np.pi).x.iloc[-1]
    assert end == pytest.approx(-1.0, abs=1e-6)
    _global(monkeypatch)
    again = mapping.mapping.images(mapping.settled(cycles=1), {}).observed["time"][0]
    assert again == pytest.approx(np.pi, abs=1e-6)
    assert gs.simulate(Loops(), duration=np.pi, every=np.pi).x.iloc[-1] == pytest.approx(1.0, abs=1e-6)


def test_a_map_made_of_another_one_has_the_content_of_its_model(monkeypatch: pytest.MonkeyPatch) -> None:
    @cached_by_content(maxsize=8)
    def compiled(mapping: Map) -> float:
        return GAIN

    mapping = LevelMap(BatchedReturnMap(Spring()).iterated(2), "energy")
    assert compiled(mapping) == 1.0
    _global(monkeypatch)
    assert compiled(mapping) == 4.0


@pytest.mark.parametrize("kind", [lambda f: f, jax.jit, functools.partial, lambda f: Calls(f).value])
def test_a_function_among_the_arguments_follows_a_change(
    kind: Callable[[Callable[[], float]], Callable[[], float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    @cached_by_content(maxsize=8)
    def compiled(draws: Callable[[], float]) -> float:
        return draws()

    def gain() -> float:
        return GAIN

    function = kind(gain)
    assert compiled(function) == 1.0
    _global(monkeypatch)
    assert compiled(function) == 4.0


def test_a_map_given_as_a_function_follows_a_change(monkeypatch: pytest.MonkeyPatch) -> None:
    def stretched(values: Any, x: Any) -> Any:
        return GAIN * x

    once = PlainMap(stretched, ("x",), invariants=(("level", lambda values, x: GAIN + 0.0 * x[0]),))
    for mapping in (once, once.iterated(2), LevelMap(once, "level")):
        values = {"level": 0.0} if isinstance(mapping, LevelMap) else {}
        one = mapping.images(once.points([[1.0]]), values)
        assert one.conserved_values.item() == 1.0
        _global(monkeypatch)
        other = mapping.images(once.points([[1.0]]), values)
        assert other.conserved_values.item() == 4.0
        assert other.points.at.item() == (16.0 if mapping == once.iterated(2) else 4.0)
        monkeypatch.undo()


def test_a_file_that_a_function_reads_as_it_is_traced(tmp_path: Path) -> None:
    file = tmp_path / "k.txt"

    class FromFile(Spring):
        def flow(self, p, s):
            return {"x": s.v, "v": -float(np.loadtxt(file)) * s.x}

    def digests() -> Any:
        from gaitsweep.models.traced_program import traced_program

        return traced_program(FromFile()).digests

    file.write_text("1.0")
    before = digests()
    file.write_text("4.00")
    changed = {name for name, digest in digests().items() if before[name] != digest}
    assert "flow" in changed
    assert "period" not in changed


def test_installed_packages_are_not_a_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Packages that `pip install --target` has put in a folder of any name are installed ones, too."""
    for folder, installed in (("target", True), ("project", False)):
        module = types.ModuleType(f"module_in_{folder}")
        module.__file__ = str(tmp_path / folder / "package" / "__init__.py")
        (tmp_path / folder / "package").mkdir(parents=True)
        if installed:
            (tmp_path / folder / "package-1.0.dist-info").mkdir()
        monkeypatch.setitem(sys.modules, module.__name__, module)
        assert is_user_module(module.__name__) is not installed


def test_a_new_function_at_the_address_of_another_one_keeps_the_caches_of_jax(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cleared: list[None] = []
    monkeypatch.setattr(jax, "clear_caches", lambda: cleared.append(None))
    for number in range(20):
        content_of(lambda x, number=number: x + number)  # collected at once
    assert cleared == []
