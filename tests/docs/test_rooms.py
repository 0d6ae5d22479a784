"""The maps of the code: the picture of the rooms, the page below it, and the docstrings of packages."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import pytest

from tests.support import ROOT

PACKAGE = ROOT / "gaitsweep"
# Packages whose files are found by their names: an example or a paper each, and the root, which has the page.
UNLISTED = (PACKAGE, PACKAGE / "examples", PACKAGE / "papers")


def test_the_picture_is_drawn_from_the_code() -> None:
    rooms = runpy.run_path(str(ROOT / "docs" / "extensions" / "rooms_picture.py"))
    assert rooms["PICTURE"].read_text() == rooms["picture"](), "run python docs/extensions/rooms_picture.py"


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("__init__.py")), ids=str)
def test_a_package_names_each_of_its_files(file: Path) -> None:
    """In its docstring or its imports; a pattern such as `*_measures.py` names several."""
    folder = file.parent
    if folder in UNLISTED:
        return
    text = file.read_text()
    listed = ast.get_docstring(ast.parse(text)) or ""
    imports = " ".join(re.findall(r"^(?:from|import) (\S+)", text, re.MULTILINE))
    modules = {path.stem for path in folder.glob("*.py") if path.stem != "__init__"}
    modules |= {path.parent.name for path in folder.glob("*/__init__.py")}
    endings = tuple(re.findall(r"`\*(\w+)\.py`", listed))
    missing = {
        name
        for name in modules
        if not re.search(rf"\b{name}\b", f"{listed} {imports}") and not name.endswith(endings)
    }
    assert not missing, f"{file.relative_to(ROOT)} does not name {', '.join(sorted(missing))}"


@pytest.mark.parametrize(
    "page", [ROOT / "docs" / "how_it_is_built.md", *sorted(PACKAGE.rglob("__init__.py"))], ids=str
)
def test_files_that_a_map_names_exist(page: Path) -> None:
    text = page.read_text()
    text = text if page.suffix == ".md" else ast.get_docstring(ast.parse(text)) or ""
    for name in re.findall(r"`([\w/]+\.py)`", text):
        places = (ROOT / name, PACKAGE / name, page.parent / name)
        assert any(place.is_file() for place in places), f"{page.relative_to(ROOT)} names {name}"
