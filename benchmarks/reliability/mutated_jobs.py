"""Jobs of `sweeps/` damaged in the ways in which people, editors and programs damage them."""

from __future__ import annotations

import copy
import itertools
import os
import random
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[2]

NUMBERS = (0, -1, 1e308, -1e308, 1e-320, 10**30, 10**400, 2**63, 0.1, 3.5, float("inf"), float("nan"), True)
EXPRESSIONS = (
    *("9**9**9", "2**(2**30)", "1/0", "sqrt(-1)", "log(0)", "0**-1", "1e999", "9" * 400),
    *("(" * 90 + "1" + ")" * 90, "beta", "beta*pi", "psi_1+psi_2"),
    *("kapa*2", "2pi", "1,5", "1:30", "0x10", "010", "1_000", "2020-11-12"),
    *("1j", "__import__('os').system('true')", "().__class__", "[1 for _ in (1,)]", "lambda: 1", "f'{1}'"),
    *("a" * 600, "min(1)", "max()", "abs(1, 2)", "pi pi"),
    *("sin(" * 40 + "1" + ")" * 40, "+".join(["1"] * 300), "-" * 200 + "1"),
)  # fmt: skip
TEXTS = (
    *("", " ", "\t", "ψ_1", "ｐｓｉ＿１", "🦿", "e\u0301", "\u202egnitfihs"),
    *("\u0000", "\x1b[31m", "\ud800", "\ufeff"),
    *("yes", "no", "null", "~", "!!python/object:os.system", "*a", "&a", "<<", "%", "@", "`"),
    *("$\\foo$", "$x"),
    *("../../etc/passwd", "/dev/zero", "/dev/stdin", ".", "a/b", "x" * 5000, "x" * 200_000, "a\nb", "{}"),
)  # fmt: skip
SYNTAX = (
    "{",
    "}",
    "[",
    "]",
    ":",
    ",",
    "'",
    '"',
    "\t",
    "- ",
    "? ",
    "&a ",
    "*a ",
    "!!int ",
    "#",
    "|",
    ">",
    "---\n",
)


class Mutant(NamedTuple):
    """A damaged job: what was done to it, and where it stands."""

    kind: str
    path: Path


class Workshop:
    """A folder of damaged jobs, each the same for the same seed and number."""

    def __init__(self, folder: Path, seed: int, tiny: bool = False) -> None:
        """Make the folder; `tiny` jobs have few rows and short runs before they are damaged."""
        self.folder, self.seed, self.tiny = folder / "sweeps", seed, tiny
        shutil.copytree(ROOT / "configs", folder / "configs")
        self.folder.mkdir()
        self.jobs = [path.read_text() for path in sorted((ROOT / "sweeps").glob("*.yaml"))]
        self.parsed = [yaml.safe_load(text) for text in self.jobs]
        self._specials = self._make_specials()

    def make(self, number: int) -> Mutant:
        """Damage a job once, or up to three times."""
        rng = random.Random(f"{self.seed} {number}")
        if rng.random() < 0.03:
            return Mutant("special file", rng.choice(self._specials))
        path = self.folder / f"job_{number:05d}.yaml"
        kind = rng.choice(list(DATA) + list(TEXT))
        data = copy.deepcopy(rng.choice(self.parsed))
        if self.tiny:
            data = shrunk(data)
        for _ in range(rng.choice((1, 1, 1, 2, 3))):
            if kind in DATA:
                DATA[kind](data, rng, self)
            else:
                DATA[rng.choice(("numbers", "misspelt", "dropped"))](data, rng, self)
        text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
        if kind in TEXT:
            text = TEXT[kind](text if rng.random() < 0.5 or self.tiny else rng.choice(self.jobs), rng)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        return Mutant(kind, path)

    def _make_specials(self) -> list[Path]:
        folder = self.folder
        os.mkfifo(folder / "fifo.yaml")
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(folder / "socket.yaml"))
        (folder / "loop.yaml").symlink_to("loop.yaml")
        (folder / "to_zero.yaml").symlink_to("/dev/zero")
        (folder / "to_fifo.yaml").symlink_to("fifo.yaml")
        (folder / "folder.yaml").mkdir()
        (folder / "empty.yaml").touch()
        (folder / "random.yaml").write_bytes(random.Random(self.seed).randbytes(100_000))
        (folder / "utf16.yaml").write_bytes(self.jobs[0].encode("utf-16"))
        with open(folder / "sparse.yaml", "wb") as sparse:
            sparse.truncate(2**36)
        names = [
            "fifo",
            "socket",
            "loop",
            "to_zero",
            "to_fifo",
            "folder",
            "empty",
            "random",
            "utf16",
            "sparse",
        ]
        (folder / "itself.yaml").write_text("config: itself.yaml\nname: a\nrun: {kind: settle}\n")
        for name in ("fifo", "to_zero", "folder", "sparse", "socket"):
            text = f"config: {name}.yaml\nname: a\nmodel: multilegged\nrun: {{kind: settle}}\n"
            (folder / f"config_{name}.yaml").write_text(text)
            names.append(f"config_{name}")
        own = [folder / f"{name}.yaml" for name in [*names, "itself", "missing"]]
        return [*own, Path("/dev/zero"), Path("/dev/null"), Path("/proc/self/environ"), Path("x" * 5000)]


def shrunk(data: dict[str, Any]) -> dict[str, Any]:
    """A job with at most two points an axis, and runs of a few cycles."""
    data = copy.deepcopy(data)
    for name, axis in (data.get("vary") or {}).items():
        groups: list[Any] = axis if isinstance(axis, list) and name in ("zip", "sample") else [axis]
        for group in groups:
            if name == "sample":
                group["n"] = 3
            elif name == "zip":
                for inner, part in group.items():
                    group[inner] = _short(part)
            else:
                data["vary"][name] = _short(axis)
    run = data.get("run") or {}
    short = {"max_cycles": 4, "duration": 0.4, "every": 0.02, "crossings": 3, "after_cycles": 0, "settle": 2}
    short |= {"most": 2, "dwell": 0.3, "first_dwell": 0.3, "initial_dwell": 0.3}
    data["run"] = {key: short.get(key, value) for key, value in run.items()}
    if run.get("kind") == "ramp" or run.get("rate"):
        data["run"]["rate"] = 1e3
    if run.get("kind") == "staircase":
        data["run"]["step"] = 1e6
    data["verify"] = 0
    return data


def _short(axis: Any) -> Any:
    if isinstance(axis, list):
        return axis[:2]
    if isinstance(axis, dict):
        for kind, points in axis.items():
            if kind == "values":
                axis[kind] = points[:2]
            elif kind in ("linspace", "logspace", "random", "sobol"):
                axis[kind] = [*points[:2], 2]
    return axis


def _places(value: Any, inside: Callable[[Any], bool]) -> list[tuple[Any, Any]]:
    """Every container and key in a document for which `inside` takes the value."""
    places = []
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        if inside(inner):
            places.append((value, key))
        places += _places(inner, inside)
    return places


def _any(value: Any) -> bool:
    return True


def _pick(data: Any, rng: random.Random, inside: Callable[[Any], bool] = _any) -> tuple[Any, Any]:
    result = _places(data, inside)
    return rng.choice(result) if result else (data, "name")


def _edited(word: str, rng: random.Random) -> str:
    """A word with one slip of the finger."""
    at = rng.randrange(len(word) + 1)
    letter = rng.choice("abcdefghijklmnopqrstuvwxyz_0123456789.- ")
    after = min(at + 1, len(word))
    swapped = word[:at] + word[after : after + 1] + word[at:after] + word[after + 1 :]
    begin, end = word[:at], word[after:]
    added, left_out, other = begin + letter + word[at:], begin + end, begin + letter + end
    return rng.choice((added, left_out, other, swapped, word.upper(), word * 2))


def _dropped(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng)
    del holder[key]


def _duplicated(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng)
    if isinstance(holder, list):
        holder.extend([copy.deepcopy(holder[key])] * rng.choice((1, 2, 50)))
    else:
        holder[_edited(str(key), rng)] = copy.deepcopy(holder[key])


def _swapped(data: Any, rng: random.Random, shop: Workshop) -> None:
    (one, a), (other, b) = _pick(data, rng), _pick(data, rng)
    if a in one if isinstance(one, dict) else True:
        one[a], other[b] = copy.deepcopy(other[b]), copy.deepcopy(one[a])


def _retyped(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng)
    old = holder[key]
    holder[key] = rng.choice(
        (None, True, [], {}, [old], {"a": old}, str(old), 7, "text", [[old]], {"values": old})
    )


def _numbers(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng, lambda value: isinstance(value, (int, float)))
    holder[key] = rng.choice(NUMBERS)


def _misspelt(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng)
    if isinstance(holder, dict) and rng.random() < 0.5:
        holder[_edited(str(key), rng)] = holder.pop(key)
    elif isinstance(holder[key], str):
        holder[key] = _edited(holder[key], rng)


def _expression(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng, lambda value: isinstance(value, (int, float, str)))
    holder[key] = rng.choice(EXPRESSIONS)


def _text(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng)
    if isinstance(holder, dict) and rng.random() < 0.4:
        holder[rng.choice(TEXTS)] = holder.pop(key)
    else:
        holder[key] = rng.choice(TEXTS)


def _nested(data: Any, rng: random.Random, shop: Workshop) -> None:
    holder, key = _pick(data, rng)
    value: Any = holder[key]
    for _ in range(rng.choice((2, 10, 70))):
        value = rng.choice(([value], {"a": value}))
    holder[key] = value


def _many(data: Any, rng: random.Random, shop: Workshop) -> None:
    """Thousands of fields that are not there, of points, of figures."""
    count = rng.choice((300, 5_000, 30_000))
    kind = rng.randrange(6)
    if kind == 0:
        data.update({f"name{i}": i for i in range(count)})
    elif kind in (1, 2):
        field = ("params", "vary")[kind - 1]
        inside = data.get(field) if isinstance(data.get(field), dict) else {}
        data[field] = {**inside, **{f"beta_{i}": [1, 2] if kind == 2 else 1 for i in range(count)}}
    elif kind == 3:
        data["vary"] = {"psi_1": {"values": [f"{i}*1e-6*pi" for i in range(count)]}}
    elif kind == 4:
        data["figures"] = [
            {"kind": "basin", "x": f"a{i}", "y": "b", "name": f"f{i}"} for i in range(count // 5)
        ]
    else:
        data["vary"] = {"sample": [{"n": 10**7, "of": {"psi_1": [0, 1]}} for _ in range(count // 10)]}


def _rows(data: Any, rng: random.Random, shop: Workshop) -> None:
    """More rows, or more points to draw, than a job may have."""
    from gaitsweep import models

    model = models.find(data["model"])() if data.get("model") in models.names() else None
    names = (
        [q.name for q in (*model.initial_conditions, *model.parameters)]
        if model is not None
        else ["psi_1", "beta"]
    )
    names = rng.sample(names, min(len(names), rng.choice((1, 2, 17))))
    count = rng.choice((10**7, 10**8, 1e18, 99_999))
    kind = rng.choice(("sobol", "random", "linspace", "logspace"))
    if rng.random() < 0.4:
        method = rng.choice(("sobol", "random"))
        data["vary"] = {"sample": {"n": count, "method": method, "of": {name: [0.1, 0.2] for name in names}}}
    elif rng.random() < 0.5:
        data["vary"] = {"zip": {name: {kind: [0.1, 0.2, count]} for name in names}}
    else:
        data["vary"] = {name: {kind: [0.1, 0.2, count]} for name in names}


def _crossed(data: Any, rng: random.Random, shop: Workshop) -> None:
    """A part of another job in the place of its own."""
    other = copy.deepcopy(rng.choice(shop.parsed))
    key = rng.choice(("run", "vary", "params", "start", "model", "config", "figures", "numerics", "engine"))
    if key in other:
        data[key] = other[key]


def _figure(data: Any, rng: random.Random, shop: Workshop) -> None:
    """A figure with other columns, or another kind of it."""
    from gaitsweep.plot import FIGURES

    names = ["row", "status", "gait", "crossing", "t", "pass", "attractor", *(data.get("vary") or {})]
    kind = rng.choice(list(FIGURES))
    fields = FIGURES[kind].model_fields
    figure: dict[str, Any] = {"kind": kind}
    for name, field in fields.items():
        if name != "kind" and (field.is_required() or rng.random() < 0.2):
            figure[name] = rng.choice(
                (*names, "psi_1", "psi_1_end", "delta_13", [rng.choice(names)], 3, "$\\foo$")
            )
    data["figures"] = [figure]


def _damaged(text: str, rng: random.Random) -> str:
    for _ in range(rng.choice((1, 2, 5))):
        at = rng.randrange(len(text) + 1)
        end = min(len(text), at + rng.choice((1, 3, 40)))
        piece = text[at:end]
        begin, rest = text[:at], text[end:]
        added = begin + rng.choice(SYNTAX) + text[at:]
        text = rng.choice((begin, begin + rest, added, begin + 2 * piece + rest, begin + piece[::-1] + rest))
    return text


def _bytes(text: str, rng: random.Random) -> str:
    letters = list(text)
    for _ in range(rng.choice((1, 4, 30))):
        letters[rng.randrange(len(letters))] = chr(
            rng.choice((rng.randrange(32), rng.randrange(256), 0xFFFE, 0x2028))
        )
    return "".join(letters)


def _twice(text: str, rng: random.Random) -> str:
    lines = text.split("\n")
    at = rng.randrange(len(lines))
    return "\n".join([*lines[:at], lines[at], *lines[at:]])


def _aliases(text: str, rng: random.Random) -> str:
    letters = "abcdefgh"[: rng.choice((2, 5, 8))]
    laughs = "x_a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    for before, name in itertools.pairwise(letters):
        laughs += f"x_{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    wide = ", ".join(f"beta{i}: 1" for i in range(375))
    return rng.choice((
        laughs + text,
        "x: &x {y: *x}\n" + text,
        "x: &x {" + wide + "}\ny: [" + ", ".join(["*x"] * 375) + "]\n" + text,
        "x: &x 1\ny: [" + ",".join(["*x"] * rng.choice((1000, 400_000))) + "]\n" + text,
        text + "\nvary: *nowhere\n",
        "<<: &m {a: 1}\n" + text,
    ))  # fmt: skip


def _deep(text: str, rng: random.Random) -> str:
    deep = rng.choice((100, 5_000, 200_000))
    blocks = "".join(" " * i + "- \n" for i in range(min(deep, 700)))
    return text + rng.choice(
        ("\nx: " + "[" * deep, "\nx: " + "{a: " * deep, "\nx:\n" + blocks, "\n" + "? " * deep)
    )


def _long(text: str, rng: random.Random) -> str:
    size = rng.choice((100_000, 1_500_000, 4_000_000))
    return rng.choice((
        text + "\n#" + "x" * size, text + "\n" * size, text + "\nx: '" + "y " * (size // 2) + "'\n",
        "x" * size + ": 1\n" + text, text + "\nx: " + "9" * size, text + "\nx: |\n" + " line\n" * (size // 6),
    ))  # fmt: skip


DATA: dict[str, Callable[[Any, random.Random, Workshop], None]] = {
    "dropped": _dropped,
    "duplicated": _duplicated,
    "swapped": _swapped,
    "retyped": _retyped,
    "numbers": _numbers,
    "misspelt": _misspelt,
    "expressions": _expression,
    "texts": _text,
    "nested": _nested,
    "many fields": _many,
    "many rows": _rows,
    "of another job": _crossed,
    "figures": _figure,
}
TEXT: dict[str, Callable[[str, random.Random], str]] = {
    "syntax": _damaged,
    "bytes": _bytes,
    "line twice": _twice,
    "aliases": _aliases,
    "deep": _deep,
    "long": _long,
}
