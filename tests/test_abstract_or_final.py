"""Methods are abstract or final, as in equinox: no class replaces a concrete method of its bases."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator

from tests.support import ROOT

# Bases that users derive from: their optional members have defaults.
BASES_OF_USERS = {
    *("Model", "HybridModel", "SteppedModel", "Chart"),
    *("Declared", "DeclaredModel", "OfMjcf", "RunKind"),
}


def _classes() -> dict[str, list[ast.ClassDef]]:
    """The classes of the package by their names."""
    classes = defaultdict(list)
    for file in sorted((ROOT / "gaitsweep").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef):
                classes[node.name].append(node)
    return classes


def _bases(node: ast.ClassDef, classes: dict[str, list[ast.ClassDef]]) -> Iterator[ast.ClassDef]:
    """All bases of a class that are in the package, nearest first."""
    for base in node.bases:
        name = ast.unparse(base).partition("[")[0].rpartition(".")[2]
        for each in classes.get(name, ()):
            if each is not node:
                yield each
                yield from _bases(each, classes)


def _methods(node: ast.ClassDef) -> dict[str, bool]:
    """Whether each method of a class is concrete, by name; without special methods."""
    return {
        method.name: not any("abstractmethod" in ast.unparse(each) for each in method.decorator_list)
        for method in node.body
        if isinstance(method, ast.FunctionDef) and not method.name.startswith("__")
    }


def _replaced() -> dict[str, list[str]]:
    """The methods that replace a concrete one, by the class whose method it is."""
    classes = _classes()
    replaced = defaultdict(list)
    for node in (node for nodes in classes.values() for node in nodes):
        for base in _bases(node, classes):
            for name in _methods(node):
                if _methods(base).get(name):
                    replaced[base.name].append(f"{node.name}.{name}")
    return replaced


def test_no_class_replaces_a_concrete_method() -> None:
    """Bases of users do have members that are replaced, so that the list has no other ones."""
    replaced = _replaced()
    others = {base: methods for base, methods in replaced.items() if base not in BASES_OF_USERS}
    assert not others, "make these methods of bases abstract or final"
    assert replaced.keys() >= BASES_OF_USERS
