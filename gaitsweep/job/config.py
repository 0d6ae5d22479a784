"""Parameter sets in separate files, whose values a job's own values override.

A job names such a file by its path (`config: ../configs/mine.yaml`) or as `builtin:NAME`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gaitsweep.design.vary import written_names
from gaitsweep.kinds import parameter_written
from gaitsweep.schema import diagnostics
from gaitsweep.schema.diagnostics import Diagnostic, JobError, quoted, unknown_field
from gaitsweep.schema.yaml_document import Document, read_document
from gaitsweep.shipped import config_file

_FIELDS = ("model", "structure", "params", "source")


class Config:
    """A job's mapping merged with its config, and the fields that came from the config.

    Args:
        raw: the job's mapping as written.
        folder: the folder to which the path of the config is relative.
    """

    def __init__(self, raw: dict[str, Any], folder: Path) -> None:
        self.raw = raw
        self.diagnostics: list[Diagnostic] = []
        self._document: Document | None = None
        self._from_config: set[diagnostics.Path] = set()
        named = raw.get("config")
        if named is None:
            return
        if not isinstance(named, (str, Path)) or not str(named).strip():
            text = f"is {quoted(named)}, but must be the path of a YAML file or builtin:NAME."
            self.diagnostics.append(Diagnostic(("config",), text))
            return
        try:
            self._document = read_document(config_file(named, folder))
        except JobError as error:
            # errors without a line are reported at the job's field
            self.diagnostics.extend(
                diagnostic
                if diagnostic.line
                else Diagnostic(("config",), f"names {diagnostic.file}, which {diagnostic.text}")
                for diagnostic in error.diagnostics
            )
            return
        self._merge(self._document.data)

    def locate(self, diagnostic: Diagnostic) -> Diagnostic:
        """The diagnostic with the config's file and line if the field comes from the config."""
        if self._document is None or diagnostic.file or diagnostic.path[:2] not in self._from_config:
            return diagnostic
        return self._document.locate(diagnostic)

    def refuse(self, diagnostics: list[Diagnostic]) -> None:
        """Refuse a job that has errors.

        Raises:
            JobError: there are diagnostics.
        """
        if diagnostics:
            raise JobError([self.locate(diagnostic) for diagnostic in diagnostics])

    def _merge(self, data: Mapping[str, Any]) -> None:
        """Add the fields of the config that the job leaves out."""
        assert self._document is not None
        for key in data:
            if key not in _FIELDS:
                diagnostic = self._document.locate(unknown_field((str(key),), "a config", _FIELDS))
                self.diagnostics.append(diagnostic)
        merged = dict(self.raw)
        if "model" in data and self.raw.get("model") is None:
            merged["model"] = data["model"]
            self._from_config.add(("model",))
        for section in ("structure", "params"):
            of_config = data.get(section)
            if of_config is not None and not isinstance(of_config, Mapping):
                text = f"is {quoted(of_config)}, but must be a mapping of names to numbers (name: number)."
                self.diagnostics.append(self._document.locate(Diagnostic((section,), text)))
                continue
            of_job = self.raw.get(section)
            if of_config and (of_job is None or isinstance(of_job, Mapping)):
                merged[section] = self._without_overridden(of_config, section) | dict(of_job or {})
                self._from_config |= {(section, str(key)) for key in of_config if key not in (of_job or {})}
        self.raw = merged

    def _without_overridden(self, of_config: Mapping[str, Any], section: str) -> dict[str, Any]:
        """The config's values without those that the job varies, moves, or sets in the other section."""
        overridden = _moving(self.raw)
        other = self.raw.get("structure" if section == "params" else "params")
        if isinstance(other, Mapping):
            overridden |= {str(key) for key in other}
        return {str(key): value for key, value in of_config.items() if key not in overridden}


def _moving(raw: Mapping[str, Any]) -> set[str]:
    """The names that an unchecked job varies, or moves while a row runs."""
    varied = {name for names in written_names(raw.get("vary")) for name in names}
    return {*varied, str(parameter_written(raw.get("run")))}
