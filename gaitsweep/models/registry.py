"""The registry of models, which are found by their names and imported at their first use.

A user's module is imported again after an edit of one of its files; messages tell why one fails.
"""

from __future__ import annotations

import importlib
import importlib.machinery
import inspect
import sys
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from gaitsweep import near_miss
from gaitsweep.contract import HybridModel, Model, SteppedModel
from gaitsweep.engine.content import ContentReader, held_result
from gaitsweep.errors import JobError, ModelError
from gaitsweep.extension import model_paths
from gaitsweep.own_modules import Stamp, data_files, installed, line_of, modules_beside, modules_in, stamp_of
from gaitsweep.shipped import EXAMPLES

# when the files of users' modules were written, and their sizes, as they were loaded
_STAMPS: weakref.WeakKeyDictionary[ModuleType, Stamp] = weakref.WeakKeyDictionary()
# the data files that these modules read as they were loaded
_DATA_FILES: weakref.WeakKeyDictionary[ModuleType, dict[Path, Stamp]] = weakref.WeakKeyDictionary()


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
        reason = _reason_raised(error)
        raise ModelError(f"is {name}, but {module_name} cannot be imported: {reason}") from error
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
    data = _DATA_FILES.get(module, {}).items()
    if edited or any(not file.is_file() or stamp_of(file) != stamp for file, stamp in data):
        with data_files() as read:
            for name in now:
                importlib.reload(sys.modules[name])
        _DATA_FILES[sys.modules[module.__name__]] = read
        now = _stamps(module) | now  # an edit may add imports; files written meanwhile are detected next time
    for name, stamp in now.items():
        _STAMPS[sys.modules[name]] = stamp
    return sys.modules[module.__name__]


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


_MOST_DESCRIBED = 3  # members that a class lacks, each with its meaning in the message
_OWN_MODEL_HINT = "write your own model as package.module:attribute, or as the path of a model file (.yaml)"
# classes that no module gives, such as those of a notebook's cells, by the name that a job has for them
_SESSION_CLASSES: weakref.WeakValueDictionary[str, type[Model]] = weakref.WeakValueDictionary()
_SESSION_PREFIX = "session:"
_SESSION_NAMES: dict[tuple[str, str], str] = {}  # their names by their own name and their content
_MODEL_FILE_ENDINGS = (".yaml", ".yml")
# the field of a manifest with the folder from which a user's model was imported, from the result directory
MODEL_FOLDER = "model_folder"


def classes() -> dict[str, str]:
    """The names of models by the names of their classes."""
    return {path.rpartition(":")[2]: name for name, path in model_paths().items()}


def names() -> tuple[str, ...]:
    """The names of the models of all extensions."""
    return tuple(model_paths())


def name_of(model_class: type[Model]) -> str:
    """The name by which `find` returns this class.

    It is the registered name, or "package.module:attribute". A class that cannot be imported again, such as
    one of a notebook's cell, has a name that holds in this Python process only (see `importable`).
    """
    if (file := getattr(model_class, "model_file", None)) is not None:
        return str(file)
    name = classes().get(model_class.__qualname__)
    if name is not None and find(name) is model_class:
        return name
    own = f"{model_class.__module__}:{model_class.__qualname__}"
    if model_class.__module__ != "__main__":
        try:
            if find(own) is model_class:
                return own
        except ModelError:
            pass
    known = next((name for name, known in _SESSION_CLASSES.items() if known is model_class), None)
    return known or _new_session_name(model_class)


def _new_session_name(model_class: type[Model]) -> str:
    """Register a class of this session; tables of earlier classes of its name keep theirs.

    A class with the content of an earlier one takes its name: a notebook's cell that was run again.
    """
    reader = ContentReader()
    reader.read(model_class)
    content = model_class.__name__, reader.digest.hexdigest()
    if content not in _SESSION_NAMES:
        number = 1 + sum(name == model_class.__name__ for name, _ in _SESSION_NAMES)
        suffix = f" ({number})" if number > 1 else ""
        _SESSION_NAMES[content] = f"{_SESSION_PREFIX}{model_class.__name__}{suffix}"
    name = _SESSION_NAMES[content]
    _SESSION_CLASSES[name] = model_class
    return name


def importable(name: str) -> bool:
    """Whether another Python process finds the model of this name."""
    return not name.startswith(_SESSION_PREFIX)


def find(name: str, folders: Sequence[Path] = ()) -> type[Model]:
    """The class of a registered model, or of a user's: "package.module:attribute", or a model file's path.

    Args:
        name: a registered name, the module and name of the user's class, or the path of a model file (.yaml).
        folders: folders whose modules may be imported, in addition to the working directory and installed
            packages.

    Raises:
        ModelError: the name is unknown (with the near miss), the module cannot be imported, or the attribute
            is missing or not a model; or the model file is missing or has errors.

    Example:
        >>> import gaitsweep as gs
        >>> hopper = gs.models.find("gaitsweep.examples.hopper:Hopper")()
        >>> {quantity.name: quantity.default for quantity in hopper.parameters}
        {'push': 2.6, 'restitution': 0.7, 'omega': 12.0, 'g': 9.81}
    """
    return held_result(("model", name, Path.cwd(), *folders), lambda: _find(name, folders))


def _find(name: str, folders: Sequence[Path]) -> type[Model]:
    """`find` without the memory of earlier calls."""
    if name in _SESSION_CLASSES:
        return _as_model(name, _SESSION_CLASSES[name])
    if not importable(name):
        raise ModelError(f"is {name}, a class that this Python process does not have or no longer has.")
    if name.endswith(_MODEL_FILE_ENDINGS):
        return _of_model_file(name, [*folders, Path.cwd()])
    paths = model_paths()
    path = paths.get(name, name)
    if ":" not in path:
        near = near_miss.suggestion(name, names())
        raise ModelError(f"is {name}, which is not a known model{near} Or {_OWN_MODEL_HINT}.")
    module_name, _, attribute = path.partition(":")
    if module_name.endswith(".py"):
        written = f"{Path(module_name).stem}:{attribute}"
        raise ModelError(f"is {name}, but a file must be named without folder and ending: write {written}.")
    if not all(part.isidentifier() for part in module_name.split(".")) or not attribute.isidentifier():
        raise ModelError(f"is {name}, which is not a valid name; {_OWN_MODEL_HINT}.")
    module = import_user_module(name, module_name, [] if name in paths else [*folders, Path.cwd()])
    if not hasattr(module, attribute):
        # bases, which a model's module imports, are abstract
        models = [
            key
            for key, member in vars(module).items()
            if inspect.isclass(member) and issubclass(member, Model) and not inspect.isabstract(member)
        ]
        near = near_miss.suggestion(attribute, models) if models else ", and no other model."
        raise ModelError(f"is {name}, but {module_name} has no {attribute}{near}")
    return _as_model(name, getattr(module, attribute))


def _of_model_file(name: str, folders: Sequence[Path]) -> type[Model]:
    """The class of a model file, whose path is relative to one of these folders or of Python's path."""
    from gaitsweep.dynamics.controllers.model_file import model_of_file

    files = [folder / name for folder in [*folders, *map(Path, sys.path), EXAMPLES]]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        own = list(dict.fromkeys(folder.resolve() for folder in folders))
        places = " and ".join(map(str, own))
        beside = [path.name for folder in own for path in folder.glob("*.yaml")]
        near = near_miss.nearest(Path(name).name, beside)
        meant = f"; did you mean {near}?" if near else "."
        raise ModelError(f"is {name}, but there is no such file in {places}{meant}")
    try:
        return model_of_file(file)
    except (JobError, ValueError, OSError) as error:
        raise ModelError(f"is {name}, which cannot be read: {str(error).rstrip('.')}.") from error


def find_of_table(attrs: Mapping[Any, Any], *, trust: bool = False) -> type[Model]:
    """The class of the model that made a table.

    The table's directory names the model, and importing a module runs its code. A user's model is therefore
    imported only from Python's import path and the working directory, and not from the result directory or
    the folder named in its manifest, unless `trust` is set.

    Args:
        attrs: the table's `.attrs`.
        trust: whether to search these two folders too.

    Raises:
        ModelError: as `find`; or the code is in one of these two folders, without `trust`.
    """
    name = attrs.get("job", {}).get("model")
    if not isinstance(name, str):
        raise ModelError(f"is {name!r}, which is not a name.")
    directory = Path(attrs.get("path", Path.cwd()))
    model_folder = attrs.get("manifest", {}).get(MODEL_FOLDER)
    # folders that came with the table, whose author may be a stranger
    folders = [directory / model_folder, directory] if isinstance(model_folder, str) else [directory]
    if name.endswith(_MODEL_FILE_ENDINGS):  # data, which runs no code
        # the manifest names the folder of the file itself
        beside_table = [
            path for path in (Path(name).name, name) if any((folder / path).is_file() for folder in folders)
        ]
        return find(beside_table[0] if beside_table else name, folders)
    if trust:
        return find(name, [folder for folder in folders if folder.is_dir()])
    if name not in model_paths() and name not in _SESSION_CLASSES:
        _refuse_code_of_table(name, directory, folders)
    return find(name)


def _refuse_code_of_table(name: str, directory: Path, folders: Sequence[Path]) -> None:
    """Refuse a model whose code would be imported from folders that came with a table.

    Args:
        name: the name of the model, with its module.
        directory: the directory of the table.
        folders: the folders that came with it.
    """
    top = name.partition(":")[0].partition(".")[0]
    if top in sys.modules or not top.isidentifier():
        return
    importable_source = _source_of(top, [*sys.path, str(Path.cwd())])
    if importable_source is not None:
        if not importable_source.parent.resolve().is_relative_to(directory.resolve()):
            return
        folders = [importable_source.parent]  # the working directory is the stranger's
    sources = (_source_of(top, [str(folder)]) for folder in folders)
    source = next((source.resolve() for source in sources if source is not None), None)
    if source is not None:
        raise ModelError(
            f"is {name}, whose code is in {source}: it came with {directory} and would run with your "
            "permissions. Use --trust (trust=True in Python) if you trust its author, or put the module into "
            "the working directory or on PYTHONPATH."
        )


def _source_of(top: str, folders: list[str]) -> Path | None:
    """The file or folder from which a module or package would be imported; nothing is imported."""
    spec = importlib.machinery.PathFinder.find_spec(top, folders)
    places = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
    return next((Path(place).absolute() for place in places if place is not None), None)


def _as_model(name: str, member: object) -> type[Model]:
    """The attribute of a module as a model; refuses one that is not a complete model."""
    if not inspect.isclass(member) or not issubclass(member, (HybridModel, SteppedModel)):
        raise ModelError(f"is {name}, which is not a model: derive it from HybridModel or SteppedModel.")
    if inspect.isabstract(member):
        missing = sorted(member.__abstractmethods__)
        described = [_described_member(member, key) for key in missing]
        lacks = "; ".join(described) if len(missing) <= _MOST_DESCRIBED else ", ".join(missing)
        raise ModelError(f"is {name}, which is not a complete model: it lacks {lacks}.")
    return member


def _described_member(model_class: type, name: str) -> str:
    """A member that a class lacks, as "period(self, params), the nominal period of a cycle (s)"."""
    member = inspect.getattr_static(model_class, name)
    arguments = "" if isinstance(member, property) else f"({', '.join(inspect.signature(member).parameters)})"
    about = (inspect.getdoc(member) or "").partition("\n")[0]
    if not about:
        return f"{name}{arguments}"
    return f"{name}{arguments}, {about[0].lower()}{about[1:].partition(';')[0].rstrip('.')}"
