"""Citation of a result: BibTeX entries of gaitsweep and of the model's paper, and a sentence on methods."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

import gaitsweep
from gaitsweep import models
from gaitsweep.errors import UserError
from gaitsweep.job.reading import default_setting
from gaitsweep.kinds import RUN_KINDS
from gaitsweep.runs.provenance import NOT_INSTALLED, paper_of
from gaitsweep.runs.sentences import lengths_of_steps, self_check_sentence
from gaitsweep.shipped import shipped
from gaitsweep.status import Status
from gaitsweep.table import Snapshot

_METHODS = {
    "tsit5": "a Runge-Kutta pair of orders 5 and 4 with step control",
    "taylor": "Taylor series of the solution with step control, of an order that follows from the tolerance",
    "rodas5p": "the Rosenbrock method Rodas5P of orders 5 and 4 with step control (Steinebach 2023)",
    "rk4": "the classic Runge-Kutta method of order 4",
    "propagator6": "a polynomial of order 6 for the propagator of the flow, which is linear between events",
    "propagator": "a polynomial for the propagator of the flow, which is linear between events",
    "semi_implicit": "the model's own steps of fixed length",
}
# Packages that compute the rows, in the order in which the sentence lists them.
_PACKAGES = {"python": "Python", "jax": "JAX", "numpy": "NumPy", "llvmlite": "llvmlite", "mujoco": "MuJoCo"}
_KEY = re.compile(r"@\w+\s*\{\s*([^\s,{}]+)\s*,")


class CitationError(UserError):
    """A result cannot be cited; the message says what is missing."""


def tool_entry(made_by: str | None = None, commit: str | None = None) -> str:
    """Format the BibTeX entry of gaitsweep, from CITATION.cff.

    Args:
        made_by: the version to cite; by default this one. The year is that of the version in CITATION.cff.
        commit: the commit to cite.

    Raises:
        CitationError: this installation lacks CITATION.cff.
    """
    file = shipped("CITATION.cff")
    cited = made_by or gaitsweep.__version__
    try:
        facts = yaml.safe_load(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CitationError(f"{file} is missing: install gaitsweep again.") from None
    doi, url = facts.get("doi"), facts.get("url") or facts.get("repository-code")
    fields = {
        "author": " and ".join(map(_author, facts["authors"])),
        "title": f"{{{facts['title']}}}",
        "version": cited,
        "year": str(facts["date-released"])[:4] if cited == facts["version"] else "",
        "doi": doi,
        "url": url,
        # styles that know no `version` print this field
        "howpublished": "" if doi or url else f"Python package, version {cited}",
        "note": f"{facts['license']}, commit {commit}" if commit else facts["license"],
    }
    return _entry("software", "gaitsweep", fields)


def citation_of(path: Path) -> tuple[str, list[str]]:
    """Format the BibTeX entries and the sentence on methods of a result directory.

    Returns:
        The text, and sentences that say what is missing in it.

    Raises:
        TableError: it is not a result directory, or is damaged.
        CitationError: rows are missing, or the manifest does not name the integration method.
    """
    snapshot = Snapshot.of(path)
    snapshot.require_sound()
    manifest, job = snapshot.manifest, snapshot.job
    if not snapshot.complete:
        raise CitationError(
            f"{path} has {snapshot.rows_done} of {manifest['rows']} rows: run the same command to complete "
            "it, then cite it."
        )
    for field in ("method", "versions"):
        if not manifest.get(field):
            text = f"The manifest of {path} has no {field}: run the job again with gaitsweep run."
            raise CitationError(text)
    name = str(job.get("model", ""))
    paper = manifest.get("paper")
    if not paper and name in models.names():
        paper = paper_of(models.find(name))
    entries = [tool_entry(manifest["versions"]["gaitsweep"], manifest.get("git_commit"))]
    missing: list[str] = []
    cited = ""
    if not paper:
        missing.append(
            f"The paper of {name} is missing: set `source`, a line, or `bibtex`, an entry, in its class, and "
            "run the job again."
        )
    else:
        entry = paper["bibtex"] or _entry("misc", re.sub(r"\W+", "_", name), {"note": paper["source"]})
        key = _KEY.search(entry)
        if key is None:
            missing.append(f"`bibtex` of {name} is no BibTeX entry: it should begin like @article{{KEY,")
        else:
            entries.append(entry)
            cited = f" [{key[1]}]"
    return "\n\n".join([*entries, _methods(name + cited, job, manifest, _changed(snapshot))]), missing


def _author(person: Mapping[str, str]) -> str:
    """Format a person or an entity of CITATION.cff for BibTeX."""
    if "name" in person:
        return f"{{{person['name']}}}"
    return ", ".join(person[part] for part in ("family-names", "given-names") if person.get(part))


def _changed(snapshot: Snapshot) -> str:
    """Name the fixed parameters and structure that differ from the model's defaults, if it is found."""
    job = snapshot.job
    try:
        kind = models.find_of_table({"job": job, "manifest": snapshot.manifest, "path": str(snapshot.path)})
        model = kind(**job.get("structure", {}))
    except (TypeError, ValueError, models.ModelError):
        return ""
    usual = {field.name: field.default for field in dataclasses.fields(model)}  # pyright: ignore[reportArgumentType]
    usual |= {q.name: default_setting(q.default) for q in model.parameters if q.default is not None}
    settings = {**job.get("structure", {}), **job.get("params", {})}
    changed = [
        f"{name} = {value:g}" if isinstance(value, float) else f"{name} = {value}"
        for name, value in settings.items()
        if usual.get(name) not in (None, dataclasses.MISSING, value)
    ]
    return f"Parameters that differ from the model's defaults: {', '.join(changed)}." if changed else ""


def _entry(kind: str, key: str, fields: Mapping[str, str]) -> str:
    """Format a BibTeX entry; fields without a value are left out."""
    lines = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items() if value)
    return f"@{kind}{{{key},\n{lines}\n}}"


def _methods(model: str, job: Mapping[str, Any], manifest: Mapping[str, Any], changed: str) -> str:
    """Describe how a table was made. Names in brackets are keys of BibTeX entries.

    `changed` is the sentence of `_changed`.
    """
    versions = manifest["versions"]
    run = job.get("run", {})
    n = manifest["rows"]
    noun = f"{'set' if job.keys() & {'search', 'sensitivity'} else 'row'}{'s' * (n != 1)}"
    axes = [f"{' with '.join(part['names'])} ({part['length']})" for part in manifest.get("axes", ())]
    over = f" over {', '.join(axes)}" if axes else ""
    inferred = manifest.get("counts", {}).get(Status.inferred.name, 0)
    split = f", of which {n - inferred} were simulated and {inferred} inferred between equal neighbours"
    check = manifest.get("self_check") or {"verdict": "off"}
    packages = {title: versions.get(key, NOT_INSTALLED) for key, title in _PACKAGES.items()}
    listed = ", ".join(f"{title} {part}" for title, part in packages.items() if part != NOT_INSTALLED)
    sentences = [
        f"The model {model} was simulated with gaitsweep {versions['gaitsweep']} [gaitsweep]: "
        f"{n} {noun}{over}{split if inferred else ''}.",
        changed,
        _run(run, " simulated row" if inferred else ""),
        "" if run.get("stationary") else _integration(job.get("numerics", {}), manifest),
        "There was no self-check." if check["verdict"] == "off" else self_check_sentence(check),
        f"Versions: {listed}.",
    ]
    return f"Methods: {' '.join(part for part in sentences if part)}"


def _integration(numerics: Mapping[str, Any], manifest: Mapping[str, Any]) -> str:
    """Describe the method of integration, with tolerances and steps where there are any."""
    method = manifest["method"]
    parts = [f"{_METHODS.get(method, 'the method')} ({method})"]
    parts += [f"{name} {numerics[name]:g}" for name in ("rtol", "atol") if name in numerics]
    if steps := lengths_of_steps(manifest.get("dt")):
        parts.append(f"steps of at most {steps}")
    parts.append(f"in {manifest.get('precision', 'float64')}")
    return f"Integration: {', '.join(parts)}."


def _run(run: Mapping[str, Any], row: str) -> str:
    """Describe the run of each `row`, with the numbers of its fields; empty for sets without a run."""
    kind = RUN_KINDS.get(str(run.get("kind")))
    if kind is None:
        return ""
    idle = kind.idle(run)
    limits = [
        f"{key} {value:g}" for key, value in run.items() if type(value) in (int, float) and key not in idle
    ]
    name, _, description = str(kind.model_fields["kind"].description or run["kind"]).partition(": ")
    if run.get("stationary"):
        description = "find stationary points of the flow, and follow them"
    return f"Run of each{row}: {description} ({', '.join([name, *limits])})."
