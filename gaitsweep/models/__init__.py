"""Models by their names, and tests of a user's model.

`registry.py` finds models by their names, which extensions give (`Extension.models` in
`gaitsweep/extension.py`), and imports a user's by `package.module:Class`, from a result directory with
`--trust` alone. `conformity.py` tests the shapes
of a model's functions against the contract, and what it states, `value_faults.py` the values at
`sampled_points.py`, and `starts.py` where a model begins; `traced_program.py` digests the program that the
functions compute.
"""

from __future__ import annotations

from typing import Any

from gaitsweep.errors import ModelError
from gaitsweep.lazy_imports import NoAttributeError
from gaitsweep.models.registry import MODEL_FOLDER, classes, find, find_of_table, importable, name_of, names

__all__ = ["MODEL_FOLDER", "ModelError", "find", "find_of_table", "importable", "name_of", "names"]


def __getattr__(name: str) -> Any:
    """A model of an extension by its class's name, imported when it is first used."""
    if not name.startswith("_") and name in (names_of_classes := classes()):
        return find(names_of_classes[name])
    raise NoAttributeError(__name__, name)


def __dir__() -> list[str]:
    return [*__all__, *classes()]
