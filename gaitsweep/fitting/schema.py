"""JSON schema of job files with the fields `search` and `sensitivity`, for editors."""

from __future__ import annotations

from typing import Any

from gaitsweep.fitting.fit_fields import MEASURES
from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.search_job import SearchOptions
from gaitsweep.fitting.sensitivity_job import Analysis
from gaitsweep.fitting.targets import TargetValue
from gaitsweep.job import schema as job_schema


def schema() -> dict[str, Any]:
    """Return the JSON schema of job files, including searches and sensitivity analyses."""
    described = job_schema()
    described["properties"]["search"] = _search()
    described["properties"]["sensitivity"] = _sensitivity()
    return described


def _ranges() -> list[dict[str, Any]]:
    """Return the schemas of a range."""
    limits = {"type": "array", "minItems": 2, "maxItems": 2, "items": {"type": ["number", "string"]}}
    return [limits, FreeParameter.model_json_schema()]


def _sensitivity() -> dict[str, Any]:
    analysis = Analysis.model_json_schema()
    share = {"type": "string", "pattern": "%"}
    parameters = {"type": "object", "additionalProperties": {"anyOf": [*_ranges(), share]}}
    measures = [measure.model_json_schema() for measure in MEASURES.values()]
    outputs = {"type": "object", "additionalProperties": {"anyOf": measures}}
    analysis["properties"] = {
        "parameters": {**parameters, "description": "constants by name: [low, high], fields, or 10%"},
        "outputs": {**outputs, "description": "what is measured, by a name for each"},
        **analysis["properties"],
    }
    analysis["required"] = ["parameters", "outputs", *analysis["required"]]
    return {**analysis, "title": "sensitivity", "description": "constants that vary, and what is measured"}


def _search() -> dict[str, Any]:
    search = SearchOptions.model_json_schema()
    free = {"type": "object", "additionalProperties": {"anyOf": _ranges()}}
    targets = {"type": "object", "additionalProperties": {"anyOf": [_target(kind) for kind in MEASURES]}}
    search["properties"] = {
        "free": {**free, "description": "constants that are searched, by name: [low, high], or fields"},
        "targets": {**targets, "description": "what is measured and wanted, by a name for each"},
        **search["properties"],
    }
    search["required"] = ["free", "targets", *search["required"]]
    return {**search, "title": "search", "description": "constants to be found, and what they should give"}


def _target(kind: str) -> dict[str, Any]:
    """Return the schema of a measure with the fields of its target value."""
    measure, target_value = MEASURES[kind].model_json_schema(), TargetValue.model_json_schema()
    properties = {**measure["properties"], **target_value["properties"]}
    return {
        **measure,
        "properties": properties,
        "required": [*measure["required"], *target_value["required"]],
    }
