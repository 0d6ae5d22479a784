"""Configs: parameter sets in separate files, whose values a job's own values override.

A job names such a file by its path (`config: ../configs/mine.yaml`) or as `builtin:NAME`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gaitsweep.design.vary import written_names
from gaitsweep.kinds import parameter_written
from gaitsweep.schema.diagnostics import Diagnostic, JobError, quoted, unknown_field
from gaitsweep.schema.diagnostics import Path as FieldPath
from gaitsweep.schema.yaml_document import Document, read_document
from gaitsweep.shipped import config_file

_FIELDS = ("model", "structure", "params", "source")


class Config:
    """A job's mapping merged with its config.

    `raw` is the merged mapping, `diagnostics` are the errors of the config.

    Args:
        raw: the job's mapping as written.
        folder: the folder to which the path of the config is relative.
    """

    def __init__(self, raw: dict[str, Any], folder: Path) -> None:
        self.raw = raw
        self.diagnostics: list[Diagnostic] = []
        self._document: Document | None = None
        self._from_config: set[FieldPath] = set()
        path = raw.get("config")
        if path is None:
            return
        if not isinstance(path, (str, Path)) or not str(path).strip():
            text = f"is {quoted(path)}, but must be the path of a YAML file or builtin:NAME."
            self.diagnostics.append(Diagnostic(("config",), text))
            return
        try:
            self._document = read_document(
                config_file(path, folder), noun="a config", fields=("model", "params")
            )
        except JobError as error:
            self.diagnostics.extend(map(_at_the_job, error.diagnostics))
            return
        self._merge(self._document)

    def locate(self, diagnostic: Diagnostic) -> Diagnostic:
        """Return the diagnostic with the config's file and line if the field comes from the config."""
        if self._document is None or diagnostic.file or diagnostic.path[:2] not in self._from_config:
            return diagnostic
        return self._document.locate(diagnostic)

    def error(self, diagnostics: list[Diagnostic]) -> JobError:
        """Return the error with these diagnostics, each with its place in the config if it has one."""
        return JobError([self.locate(diagnostic) for diagnostic in diagnostics])

    def refuse(self, diagnostics: list[Diagnostic]) -> None:
        """Refuse a job that has errors.

        Raises:
            JobError: there are diagnostics.
        """
        if diagnostics:
            raise self.error(diagnostics)

    def _merge(self, document: Document) -> None:
        """Add the fields of the config that the job leaves out."""
        unknown = [
            unknown_field((str(key),), "a config", _FIELDS) for key in document.data if key not in _FIELDS
        ]
        self.diagnostics.extend(map(document.locate, unknown))
        merged = dict(self.raw)
        if "model" in document.data and self.raw.get("model") is None:
            merged["model"] = document.data["model"]
            self._from_config.add(("model",))
        for section in ("structure", "params"):
            of_config = document.data.get(section)
            if of_config is not None and not isinstance(of_config, Mapping):
                text = f"is {quoted(of_config)}, but must be a mapping of names to numbers (name: number)."
                self.diagnostics.append(document.locate(Diagnostic((section,), text)))
                continue
            of_job = {} if self.raw.get(section) is None else self.raw[section]
            if of_config and isinstance(of_job, Mapping):
                merged[section] = self._without_overridden(of_config, section) | dict(of_job)
                self._from_config |= {(section, str(key)) for key in of_config if key not in of_job}
        self.raw = merged

    def _without_overridden(self, of_config: Mapping[str, Any], section: str) -> dict[str, Any]:
        """Return values of the config, without those that the job varies, moves, or sets elsewhere."""
        overridden = _varied_or_moved(self.raw)
        other = self.raw.get("structure" if section == "params" else "params")
        if isinstance(other, Mapping):
            overridden |= {str(key) for key in other}
        return {str(key): value for key, value in of_config.items() if key not in overridden}


def _at_the_job(diagnostic: Diagnostic) -> Diagnostic:
    """Return a diagnostic of a config, at the job's field if it has no line in the config."""
    if diagnostic.line:
        return diagnostic
    return Diagnostic(("config",), f"names {diagnostic.file}, which {diagnostic.text}")


def _varied_or_moved(raw: Mapping[str, Any]) -> set[str]:
    """Return the names that an unchecked job varies, or moves while a row runs."""
    varied = {name for names in written_names(raw.get("vary")) for name in names}
    return {*varied, str(parameter_written(raw.get("run")))}
