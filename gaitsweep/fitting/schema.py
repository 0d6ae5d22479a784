"""JSON schema of job files with the fields `search` and `sensitivity`, for editors."""

from __future__ import annotations

from typing import Any

from gaitsweep.fitting.fit_fields import MEASURES
from gaitsweep.fitting.free_parameters import FreeParameter
from gaitsweep.fitting.search_job import SearchOptions
from gaitsweep.fitting.sensitivity_job import Analysis
from gaitsweep.fitting.targets import TargetValue
from gaitsweep.job import schema as job_schema
from gaitsweep.schema.strict_model import StrictModel


def schema() -> dict[str, Any]:
    """Return the JSON schema of job files, including searches and sensitivity analyses."""
    job = job_schema()
    job["properties"]["search"] = _search()
    job["properties"]["sensitivity"] = _sensitivity()
    for field in ("search", "sensitivity"):  # references begin at the root
        job["$defs"] |= job["properties"][field].pop("$defs", {})
    return job


def _ranges() -> list[dict[str, Any]]:
    """Return the schemas of a range."""
    limits = {"type": "array", "minItems": 2, "maxItems": 2, "items": {"type": ["number", "string"]}}
    return [limits, FreeParameter.model_json_schema()]


def _by_name(entries: list[dict[str, Any]], description: str) -> dict[str, Any]:
    """Return the schema of a field with entries by name, each of which has one of the schemas `entries`."""
    return {"type": "object", "additionalProperties": {"anyOf": entries}, "description": description}


def _joined(first: dict[str, Any], last: dict[str, Any]) -> dict[str, Any]:
    """Return the schema with the fields of two, the required ones among them."""
    return {
        "properties": {**first["properties"], **last["properties"]},
        "required": [*first["required"], *last["required"]],
    }


def _with_fields(settings: type[StrictModel], fields: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the schema of some settings with further required fields before them."""
    schema_of_settings = settings.model_json_schema()
    return schema_of_settings | _joined({"properties": fields, "required": [*fields]}, schema_of_settings)


def _sensitivity() -> dict[str, Any]:
    """Return the schema of the field `sensitivity`."""
    ranges = [*_ranges(), {"type": "string", "pattern": "%"}]
    measures = [measure.model_json_schema() for measure in MEASURES.values()]
    fields = {
        "parameters": _by_name(ranges, "constants by name: [low, high], fields, or 10%"),
        "outputs": _by_name(measures, "what is measured, by a name for each"),
    }
    title = {"title": "sensitivity", "description": "constants that vary, and what is measured"}
    return _with_fields(Analysis, fields) | title


def _search() -> dict[str, Any]:
    """Return the schema of the field `search`."""
    targets = [_target(kind) for kind in MEASURES]
    fields = {
        "free": _by_name(_ranges(), "constants that are searched, by name: [low, high], or fields"),
        "targets": _by_name(targets, "what is measured and wanted, by a name for each"),
    }
    title = {"title": "search", "description": "constants to be found, and what they should give"}
    return _with_fields(SearchOptions, fields) | title


def _target(kind: str) -> dict[str, Any]:
    """Return the schema of a measure with the fields of its target value."""
    measure = MEASURES[kind].model_json_schema()
    return measure | _joined(measure, TargetValue.model_json_schema())
