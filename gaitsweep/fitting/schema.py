"""The JSON schema of job files with the field `search`, for editors."""

from __future__ import annotations

from typing import Any

from gaitsweep.fitting.free import Free
from gaitsweep.fitting.measures import MEASURES
from gaitsweep.fitting.search_job import Choice
from gaitsweep.fitting.targets import Aim
from gaitsweep.job import schema as job_schema


def schema() -> dict[str, Any]:
    """The JSON schema of a job file, that of a search too; each field has a description."""
    described = job_schema()
    described["properties"]["search"] = _search()
    return described


def _search() -> dict[str, Any]:
    search = Choice.model_json_schema()
    limits = {"type": "array", "minItems": 2, "maxItems": 2, "items": {"type": ["number", "string"]}}
    free = {"type": "object", "additionalProperties": {"anyOf": [limits, Free.model_json_schema()]}}
    targets = {"type": "object", "additionalProperties": {"anyOf": [_target(kind) for kind in MEASURES]}}
    search["properties"] = {
        "free": {**free, "description": "constants that are searched, by name: [low, high], or fields"},
        "targets": {**targets, "description": "what is measured and wanted, by a name for each"},
        **search["properties"],
    }
    search["required"] = ["free", "targets", *search["required"]]
    return {**search, "title": "search", "description": "constants to be found, and what they should give"}


def _target(kind: str) -> dict[str, Any]:
    """A measure's schema with the fields of what it should come to."""
    measure, aim = MEASURES[kind].model_json_schema(), Aim.model_json_schema()
    properties = {**measure["properties"], **aim["properties"]}
    return {**measure, "properties": properties, "required": [*measure["required"], *aim["required"]]}
