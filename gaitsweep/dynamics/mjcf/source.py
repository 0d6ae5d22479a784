"""The file of an MJCF, compiled once for each content of it and its files; names of its elements."""

# MuJoCo's compiled modules come without types.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gaitsweep.near_miss import suggestion
from gaitsweep.own_modules import Stamp, stamp_of

# MuJoCo is imported when a body is made, since that takes time

# The stamps of an MJCF and of all files that it refers to; None for a missing file.
Stamps: TypeAlias = tuple[Stamp | None, ...]
# The files of each MJCF, and their stamps when its references were read.
_FILES_OF_MJCF: dict[Path, tuple[tuple[Path, ...], Stamps]] = {}


def compiled(source: Any) -> Any:
    """MuJoCo's compiled model of a path or of the XML itself.

    Args:
        source: a path, the XML, or a compiled model, which is returned.

    Raises:
        ValueError: MuJoCo refuses the XML.
        FileNotFoundError: there is no file at the path.
        IsADirectoryError: there is a folder.
    """
    import mujoco

    if isinstance(source, mujoco.MjModel):
        return source
    if isinstance(source, str) and source.lstrip().startswith("<"):
        return mujoco.MjModel.from_xml_string(source)
    if Path(source).is_dir():
        raise IsADirectoryError(f"The MJCF {source} is a folder, but must be a file.")
    if not Path(source).is_file():
        raise FileNotFoundError(f"The MJCF {source} does not exist.")
    return mujoco.MjModel.from_xml_path(str(source))


@functools.lru_cache(maxsize=32)
def compiled_content(source: str, _stamps: Stamps) -> Any:
    """MuJoCo's compiled model of a path or XML.

    Args:
        source, _stamps: as `content_key` gives them.

    Raises:
        ValueError: MuJoCo refuses it.
        FileNotFoundError: there is no such file.
    """
    return compiled(source)


@functools.lru_cache(maxsize=32)
def content_digest(source: str, stamps: Stamps) -> str:
    """The digest of a compiled model; arguments as `content_key` gives them."""
    import mujoco

    model = compiled_content(source, stamps)
    buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(buffer.tobytes()).hexdigest()


def portable_xml(path: Path) -> str:
    """The XML of an MJCF, which compiles in any folder: the paths of meshes and textures are absolute.

    Raises:
        ValueError: MuJoCo refuses it.
        FileNotFoundError: there is no such file.
    """
    if _references(path) in (None, (path,)):
        return path.read_text(encoding="utf-8")
    import mujoco

    spec = mujoco.MjSpec.from_file(str(path))  # which has the elements of included files
    folder = path.parent.resolve()
    spec.meshdir = str(folder / spec.meshdir)
    spec.texturedir = str(folder / spec.texturedir)
    return spec.to_xml()


def stamps_of_mjcf(path: Path) -> Stamps:
    """The stamps of an MJCF and of the files that it refers to: includes, meshes, height fields, textures."""
    files, stamps_as_read = _FILES_OF_MJCF.get(path, ((path,), None))
    stamps = _stamps(files)
    if stamps == stamps_as_read:
        return stamps
    # a file has changed, and may refer to others than before
    references = _references(path)
    if references is None:
        return _stamps([path])
    stamps = _stamps(references)
    _FILES_OF_MJCF[path] = references, stamps
    return stamps


def _stamps(files: Iterable[Path]) -> Stamps:
    """The stamp of each file."""
    return tuple(stamp_of(file) if file.is_file() else None for file in files)


def _references(path: Path) -> tuple[Path, ...] | None:
    """An MJCF and the files that it refers to; None if it, or one that it includes, cannot be read."""
    if not path.is_file():  # of a folder, MuJoCo prints that it is too large
        return None
    import mujoco

    try:
        names = mujoco.mju_getXMLDependencies(str(path))
    except mujoco.FatalError:  # MuJoCo's compiler reports it
        return None
    return tuple(sorted(map(Path, names)))


def keyframe_number(m: Any, name: str) -> int | None:
    """The number of the keyframe of this name, of the first one for an empty name; None: there is none.

    Raises:
        ValueError: the MJCF has no keyframe of this name.
    """
    if not name:
        return 0 if m.nkey else None
    names = [m.key(i).name for i in range(m.nkey)]
    if name not in names:
        near = suggestion(name, names) if names else ": it has none."
        raise ValueError(f"The MJCF has no keyframe '{name}'{near}")
    return names.index(name)


def identifier(name: str) -> str:
    """The name of an element of an MJCF as that of a quantity: other characters are underscores."""
    word = re.sub(r"\W", "_", name)
    return f"_{word}" if word[:1].isdigit() else word
