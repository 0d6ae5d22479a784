"""Import of a user's module, again after an edit of one of its files; messages about one that fails."""

from __future__ import annotations

import importlib
import importlib.machinery
import sys
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from gaitsweep import near_miss
from gaitsweep.errors import UserError
from gaitsweep.own_modules import Stamp, data_files, installed, line_of, modules_beside, modules_in, stamp_of

# when the files of users' modules were written, and their sizes, as they were loaded
_STAMPS: weakref.WeakKeyDictionary[ModuleType, Stamp] = weakref.WeakKeyDictionary()
# the data files that these modules read as they were loaded
_DATA_FILES: weakref.WeakKeyDictionary[ModuleType, dict[Path, Stamp]] = weakref.WeakKeyDictionary()


class ModelError(UserError, LookupError):
    """A model is not available; the message continues a sentence that begins with "The model"."""

    subject = "The model "


def import_user_module(name: str, module_name: str, folders: list[Path]) -> object:
    """Import the module of a model.

    Args:
        name: the name of the model, for messages.
        module_name: that of its module.
        folders: those of a user's modules; empty for a module of an extension.

    Raises:
        ModelError: the module cannot be imported, or another one of its name has been loaded.
    """
    try:
        with _on_import_path(folders):
            with data_files() as read:
                module = importlib.import_module(module_name)
            if folders:
                _DATA_FILES.setdefault(module, {}).update(read)
                module = _reloaded_if_edited(module)
    except ModuleNotFoundError as error:
        reason = _reason_not_found(module_name, error.name, folders) or _reason_raised(error)
        raise ModelError(f"is {name}, but {module_name} cannot be imported: {reason}") from error
    except (Exception, SystemExit) as error:  # a user's module may raise any exception, which is reported
        raise ModelError(
            f"is {name}, but {module_name} cannot be imported: {_reason_raised(error)}"
        ) from error
    _refuse_namesake(name, module_name, folders)
    return module


def _reason_raised(error: BaseException) -> str:
    """Format an exception by its type, its line in a user's file, and its message."""
    return f"{type(error).__name__}{line_of(error)}: {str(error).rstrip('.')}."


def _reason_not_found(module_name: str, missing: str | None, folders: list[Path]) -> str | None:
    """The message that a user's module does not exist, or None if an import inside it failed."""
    if missing is None or not f"{module_name}.".startswith(f"{missing}."):
        return None
    *package, last = missing.split(".")
    places = list(dict.fromkeys(folder.resolve().joinpath(*package) for folder in folders))
    places = [place for place in places if place.is_dir()]
    if not places:
        return None
    near = near_miss.nearest(last, sorted({module for place in places for module in modules_in(place)}))
    meant = "." if near is None else f"; did you mean {'.'.join([*package, near])}?"
    looked = " and ".join(str(place) for place in places)
    return f"no module of that name is installed or in {looked}{meant}"


def _reloaded_if_edited(module: ModuleType) -> ModuleType:
    """The user's module, reloaded together with the modules beside it if one of their files has changed.

    Changes in data files that they read on import count too.
    """
    if installed(module):
        return module
    now = _stamps(module)
    edited = any(_STAMPS.get(sys.modules[name], stamp) != stamp for name, stamp in now.items())
    if edited or any(_is_changed(file, stamp) for file, stamp in _DATA_FILES.get(module, {}).items()):
        with data_files() as read:
            for name in now:
                importlib.reload(sys.modules[name])
        _DATA_FILES[sys.modules[module.__name__]] = read
        now = _stamps(module) | now  # an edit may add imports; files written meanwhile are detected next time
    for name, stamp in now.items():
        _STAMPS[sys.modules[name]] = stamp
    return sys.modules[module.__name__]


def _is_changed(file: Path, stamp: Stamp) -> bool:
    """Whether a file is gone or was written since its stamp."""
    return not file.is_file() or stamp_of(file) != stamp


def _stamps(module: ModuleType) -> dict[str, Stamp]:
    """The stamps of a user's module and of the loaded modules beside it."""
    return {name: stamp_of(file) for name, file in modules_beside(module).items() if name in sys.modules}


@contextmanager
def _on_import_path(folders: list[Path]) -> Iterator[None]:
    """Append folders to the import path, so that a user's file does not hide an installed package."""
    added = [str(folder.resolve()) for folder in folders]
    sys.path.extend(added)
    importlib.invalidate_caches()
    try:
        yield
    finally:
        for folder in added:
            sys.path.reverse()
            sys.path.remove(folder)
            sys.path.reverse()


def _refuse_namesake(name: str, module_name: str, folders: list[Path]) -> None:
    """Refuse a module if another one of the same name has been loaded, since that would be used instead."""
    top = module_name.partition(".")[0]
    loaded = getattr(sys.modules.get(top), "__file__", None)
    for folder in folders:
        spec = importlib.machinery.PathFinder.find_spec(top, [str(folder.resolve())])
        if spec is not None and spec.origin is not None:
            if loaded is not None and Path(loaded).resolve() != Path(spec.origin).resolve():
                other = f"another module {top} has been loaded from {loaded}"
                raise ModelError(f"is {name}, but {other}: rename {spec.origin}.")
            return
