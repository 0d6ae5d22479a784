"""Files that come with gaitsweep and its extensions: configs, jobs, notebooks, models with their jobs."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from gaitsweep.extension import extensions, folders

_PACKAGE = Path(__file__).parent
EXAMPLES = _PACKAGE / "examples"  # models with their jobs
BUILTIN = "builtin:"  # begins the name of a shipped file, in place of its path


def shipped(name: str) -> Path:
    """The path of a shipped folder or file, such as `sweeps/quick_basins.yaml`.

    In an installed wheel they are inside the package, in a checkout beside it.
    """
    inside = _PACKAGE / "shipped" / name
    return inside if inside.exists() else _PACKAGE.parent / name


def job_file(path: str | Path) -> Path:
    """The path of a job, or of the shipped one that `builtin:quick_basins` names."""
    return _named(path, *job_folders()) or Path(path)


def config_file(path: str | Path, folder: Path) -> Path:
    """The path of a config that a job in `folder` names, or of the shipped one: `builtin:NAME`."""
    return _named(path, *folders("configs")) or folder / path


def job_folders() -> list[Path]:
    """The folders of jobs that come with extensions, and that of the examples."""
    return [*folders("jobs"), EXAMPLES]


def portable_text(file: Path) -> str:
    """The text of a shipped file for a user's folder.

    It names shipped configs as `builtin:NAME`, and an example's model as the module or file beside the job.
    """
    text = file.read_text(encoding="utf-8")
    if file.suffix != ".yaml":
        return text
    text = re.sub(r"^(config: *)\.\./configs/(\w+)\.yaml", rf"\g<1>{BUILTIN}\g<2>", text, flags=re.MULTILINE)
    return re.sub(r"^(model: *)(gaitsweep\.examples\.|walkers/)", r"\g<1>", text, flags=re.MULTILINE)


def shipped_as(file: Path, similar: Callable[[str, list[str]], str | None]) -> str | None:
    """The shipped job that was meant by a file that is missing: "builtin:quick_basins, which comes with ...".

    Args:
        file: the missing file. A name of another folder has to be the shipped job's, since it is rarely meant
            where it is only similar.
        similar: the most similar name of a list, or None.
    """
    owners: dict[str, str] = {}
    for folder in reversed(job_folders()):  # of a name in two folders, the first one's
        owners |= dict.fromkeys((job.stem for job in folder.glob("*.yaml")), _owner(folder))
    name = similar(file.stem, sorted(owners)) if file.parent in job_folders() else file.stem
    return f"{BUILTIN}{name}, which comes with {owners[name]}" if name in owners else None


def _owner(folder: Path) -> str:
    """Owner of a folder's jobs, in words: gaitsweep, or an extension."""
    if folder in (EXAMPLES, shipped("sweeps")):
        return "gaitsweep"
    owners = (name for name, extension in extensions().items() if extension.jobs == folder)
    return f"the extension {next(owners)}"


def _named(path: str | Path, *folders: Path) -> Path | None:
    """The file of these folders that `builtin:NAME` stands for, whether it exists or not; None for a path."""
    name = str(path)
    if not name.startswith(BUILTIN):
        return None
    stem = name.removeprefix(BUILTIN).removesuffix(".yaml")
    files = [folder / f"{stem}.yaml" for folder in folders]
    if not files or Path(stem).name != stem:  # a name has no folder
        return Path(name)
    return next((file for file in files if file.is_file()), files[0])
