"""The rooms of the code and the way of a row: this script draws docs/images/rooms.svg.

Rooms and their order are those of the import contract in pyproject.toml, their sentences those of docstrings.
The way of a row names a function at each step, which has to exist.
"""

from __future__ import annotations

import ast
import html
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "images" / "rooms.svg"

# The way of a row: what happens, and the function where it happens.
WAY = (
    ("a YAML file becomes a checked job", "gaitsweep.job.load:load_job"),
    ("model, recorder, engine and steps are chosen", "gaitsweep.runs.prepare:prepare"),
    ("blocks of rows that the directory lacks are run", "gaitsweep.runs.execute:run_job"),
    ("each lane takes the next row of its block", "gaitsweep.engine.sweep.sweep:sweep"),
    ("a step of one row, its events located", "gaitsweep.engine.advance:attempt"),
    (
        "the block's records and labels become a part of the table",
        "gaitsweep.table.directory:SharedWriter",
    ),
    ("parts are checked, joined and read as one table", "gaitsweep.table.reading:load"),
    ("figures are drawn from the table alone", "gaitsweep.runs.figures:draw_figures"),
)
WIDTH, BAR_HEIGHT, NAME_WIDTH = 1080, 34, 200  # pixels


def layers() -> list[list[str]]:
    """Names of the rooms, from the top layer to the ground."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    ordered = settings["tool"]["importlinter"]["contracts"][0]["layers"]
    return [[name.strip().removeprefix("gaitsweep.") for name in layer.split("|")] for layer in ordered]


def sentence(room: str) -> str:
    """First line of a room's docstring."""
    folder = ROOT / "gaitsweep" / room
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    return (ast.get_docstring(ast.parse(file.read_text())) or "").splitlines()[0]


def place(target: str) -> str:
    """File and line of a function or class `module:name`.

    Raises:
        LookupError: it does not exist.
    """
    module, _, name = target.partition(":")
    file = ROOT / (module.replace(".", "/") + ".py")
    nodes = ast.walk(ast.parse(file.read_text()))
    if not any(isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name for node in nodes):
        raise LookupError(f"{file.relative_to(ROOT)} has no {name}")
    return f"{file.relative_to(ROOT)}:{name}"


def picture() -> str:
    """The picture as SVG text: a bar for each room, and beside it the steps of a row that happen there."""
    steps: dict[str, list[str]] = {}
    for number, (_, target) in enumerate(WAY, 1):
        steps.setdefault(target.split(".")[1].partition(":")[0], []).append(str(number))
    lines, y = [], 10
    for layer in layers():
        for room in layer:
            text = html.escape(sentence(room))
            size = f'width="{WIDTH - 70}" height="{BAR_HEIGHT - 6}"'
            lines.append(f'<rect x="60" y="{y}" {size} rx="4" fill="#eef2f5"/>')
            lines.append(f'<text x="72" y="{y + 19}" font-weight="bold">{room}</text>')
            lines.append(f'<text x="{72 + NAME_WIDTH}" y="{y + 19}">{text}</text>')
            numbers = ", ".join(steps.get(room, []))
            lines.append(f'<text x="30" y="{y + 19}" text-anchor="middle">{numbers}</text>')
            y += BAR_HEIGHT
        y += 6
    y += 14
    for number, (what, target) in enumerate(WAY, 1):
        lines.append(f'<text x="30" y="{y}" text-anchor="middle">{number}</text>')
        lines.append(f'<text x="72" y="{y}">{html.escape(what)}: {place(target)}</text>')
        y += 22
    body = "\n".join(lines)
    style = 'font-family="sans-serif" font-size="14" fill="#222"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y}" {style}>\n{body}\n</svg>\n'


if __name__ == "__main__":
    PICTURE.write_text(picture())
    print(PICTURE.relative_to(ROOT))
