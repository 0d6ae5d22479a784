"""References written from the package itself.

While the site is built, a comment `<!-- described: NAME -->` in a page is replaced by what the function NAME
of `DESCRIBED` writes, as Markdown, with all up to `<!-- end: NAME -->` if that follows. The command
`python docs/extensions/described_package.py` writes the same between the two comments, without pictures, for
readers of the pages on a forge; with `--check` it writes nothing, and exits with 1 if a page would change.
"""

from __future__ import annotations

import dataclasses
import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import gallery
import home_explorer
import yaml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

Described = Mapping[str, Any]  # a JSON schema

MARK = re.compile(
    r"^<!-- described: (?P<name>[a-z_]+) -->$(?:(?P<stored>.*?)^<!-- end: (?P=name) -->$)?",
    re.MULTILINE | re.DOTALL,
)

_FIELD_COLUMNS = ("field", "meaning", "value", "default")
_SECTIONS = {
    "vary": "what-varies-vary",
    "run": "run-kinds-run",
    "numerics": "numerics",
    "style": "style-of-figures-style",
    "engine": "engine",
    "figures": "figures-figures",
    "search": "fit-constants-search",
    "sensitivity": "sensitivity-sensitivity",
}
_TYPES = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
    "array": "list",
    "object": "fields",
}


def commands() -> Iterator[str]:
    """Each command of `gaitsweep`, its arguments and its options."""
    import typer

    from gaitsweep.cli.commands import app

    yield from _commands(typer.main.get_command(app), "gaitsweep", "##")


def _commands(group: Any, before: str, heading: str) -> Iterator[str]:
    import typer

    for name, command in group.commands.items():
        words = f"{before} {name}"
        yield f"{heading} {words}\n"
        yield f"{_escaped(command.help or '')}\n"
        if hasattr(command, "commands"):
            yield from _commands(command, words, f"{heading}#")
            continue
        usage = command.get_usage(typer.Context(command, info_name=words)).removeprefix("Usage: ")
        yield f"```text\n{re.sub(r'[{}]', '', ' '.join(usage.split()))}\n```\n"
        rows = [_parameter(parameter) for parameter in command.params]
        if rows:
            yield from _table(("argument or option", "meaning"), rows)


def _parameter(parameter: Any) -> tuple[str, str]:
    """An argument or an option of a command, and its help."""
    option = parameter.opts[0].startswith("-")
    written = " ".join([*parameter.opts[:1], *([parameter.metavar] if parameter.metavar else [])])
    name = f"`{written}`" if option else f"`{parameter.metavar or parameter.name}`"
    default = parameter.default
    text = parameter.help or ""
    if (
        option
        and default not in (None, False, "", (), [])
        and "default" not in text
        and not _infinite(default)
    ):
        text = f"{text} Default: {default}."
    return name, _escaped(text)


def _infinite(value: Any) -> bool:
    values = value if isinstance(value, tuple) else (value,)
    return any(isinstance(item, float) and math.isinf(item) for item in values)


def job_fields() -> Iterator[str]:
    """The fields of a job."""
    job = _schema()
    rows = []
    for name, schema in job["properties"].items():
        title, *rest = _field(name, schema, job["required"])
        rows.append((f"[{title}](#{_SECTIONS[name]})" if name in _SECTIONS else title, *rest))
    yield from _table(_FIELD_COLUMNS, rows)


AXIS_EXAMPLES: dict[str, Any] = {
    "values": {"m_B": {"values": [0.7, 0.9]}},
    "linspace": {"psi_1": {"linspace": [0, "2*pi", 64], "at": "centre"}},
    "logspace": {"K": {"logspace": [1.0e4, 1.0e6, 9]}},
    "random": {"psi_1": {"random": [0, "2*pi", 100], "seed": 1}},
    "sobol": {"psi_1": {"sobol": [0, "2*pi", 128]}},
    "zip": {"psi_1": [1.0, 2.0, 3.0], "psi_2": [3.0, 2.0, 1.0]},
    "sample": {"n": 64, "method": "sobol", "of": {"psi_1": [0, "2*pi"], "psi_2": [0, "2*pi"]}},
}


def axes() -> Iterator[str]:
    """The ways to write an axis, and the groups of axes."""
    vary = _schema()["properties"]["vary"]
    for axis in vary["additionalProperties"]["anyOf"]:
        if "properties" in axis:
            yield from _part(axis, heading="###")
            yield from _example({"vary": AXIS_EXAMPLES[axis["title"].lower()]})
    for group in ("zip", "sample"):
        schema = vary["properties"][group]
        yield f"### {group}\n\n{_sentence(schema['description'])}\n"
        one = schema["anyOf"][0]
        if "properties" in one:
            yield from _fields(one)
        yield from _example({"vary": {group: AXIS_EXAMPLES[group]}})


def runs() -> Iterator[str]:
    """The run kinds."""
    from gaitsweep.kinds import RUN_KINDS
    from gaitsweep.plot import FIGURES

    examples = {job["run"]["kind"]: job["run"] for job in map(gallery.job_of, gallery.ENTRIES)}
    for kind, part in RUN_KINDS.items():
        yield from _part(part.model_json_schema(), kind)
        if kind in examples:
            yield from _example({"run": examples[kind]})
        suited = [name for name, figure in FIGURES.items() if kind in figure.runs or name in part.figures]
        links = ", ".join(f"[`{name}`](#figure-{name.replace('_', '-')})" for name in suited)
        yield f"Figures: {links or 'none'}.\n"


def figures() -> Iterator[str]:
    """The kinds of figures."""
    from gaitsweep.plot import FIGURES
    from gaitsweep.plot.figure_style import STYLE_FIELDS

    for kind, part in FIGURES.items():
        yield f"(figure-{kind.replace('_', '-')})="
        described = part.model_json_schema()
        own = {name: schema for name, schema in described["properties"].items() if name not in STYLE_FIELDS}
        yield from _part(described | {"properties": own}, kind)
        if kind in gallery.ENTRIES:
            yield f"![A figure of kind {kind}](../build/gallery/{kind}.png)\n"
            yield from _example({"figures": [gallery.fields(kind)]})


def style() -> Iterator[str]:
    """The fields of `style`, which each figure may have too."""
    yield from _fields(_schema()["$defs"]["FigureStyle"])


def explorer() -> Iterator[str]:
    """The explorer in a frame, and a link to the whole page."""
    page = home_explorer.PAGE
    yield f'<iframe class="explorer" src="{page}" title="Explorer of 300 starts" loading="lazy"></iframe>\n'
    yield f'<p><a href="{page}">Open the explorer in a page of its own</a></p>\n'


def pictures() -> Iterator[str]:
    """A picture of each kind of figure, with its job and command."""
    from gaitsweep.plot import FIGURES

    yield "::::{container} gallery\n"
    for kind in gallery.ENTRIES:
        about = _escaped(_sentence(FIGURES[kind].model_json_schema()["description"]))
        link, job = f"job_reference.md#figure-{kind.replace('_', '-')}", gallery.job_path(kind)
        yield f":::{{container}} entry\n[![{kind}](../build/gallery/{kind}.png)]({link})\n"
        yield f"**[{kind}]({link})** {about} Job: [{job.rpartition('/')[2]}](../{job}).\n"
        yield f"```bash\n{gallery.command(kind)}\n```\n:::\n"
    yield "::::\n"


def numerics() -> Iterator[str]:
    """The fields of `numerics`."""
    yield from _fields(_schema()["$defs"]["NumericsSpec"])


def engine() -> Iterator[str]:
    """The fields of `engine`."""
    yield from _fields(_schema()["$defs"]["EngineChoice"])


def search() -> Iterator[str]:
    """The fields of `search`, of a free constant and of a target."""
    from gaitsweep.fitting.free_parameters import FreeParameter
    from gaitsweep.fitting.targets import TargetValue

    yield from _fields(_schema()["properties"]["search"])
    yield "### A free constant\n\n`[low, high]`, or these fields:\n"
    yield from _fields(FreeParameter.model_json_schema())
    yield "### A target\n\nThe fields of a [measure](#measures), and:\n"
    yield from _fields(TargetValue.model_json_schema())


def sensitivity() -> Iterator[str]:
    """The fields of `sensitivity`."""
    yield from _fields(_schema()["properties"]["sensitivity"])


def measures() -> Iterator[str]:
    """The measures of searches and sensitivity analyses."""
    from gaitsweep.fitting.fit_fields import MEASURES

    for kind, part in MEASURES.items():
        yield from _part(part.model_json_schema(), kind, label="measure")


def models() -> Iterator[str]:
    """Each registered model: structure, parameters, starts, observables, signals, label fields, gaits."""
    from gaitsweep import models as registry
    from gaitsweep.cli import show

    for name in registry.names():
        kind = registry.find(name)
        instance = kind()
        about = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
        yield f"## {name}\n\n{_escaped(about)} {_escaped(kind.source)}\n"
        structure = [show.structure_field(field) for field in dataclasses.fields(kind)]  # pyright: ignore
        if structure:
            yield "### Structure\n\nWhat shapes the arrays; one job for each.\n"
            yield from _table(("name", "default", "allowed", "meaning"), _coded(structure))
        for title, quantities in (
            ("Parameters", instance.parameters),
            ("Start values", instance.initial_conditions),
        ):
            rows = []
            for q in quantities:
                name, unit, default, allowed, meaning, source = show.quantity(q)
                rows.append((name, meaning, unit, default, allowed, source))
            yield f"### {title}\n"
            yield from _table(("name", "meaning", "unit", "default", "allowed", "source"), _coded(rows))
        for title, quantities in (
            ("Observables", instance.observables),
            ("Signals", instance.signals),
            ("Label fields", instance.label_fields),
        ):
            if quantities:
                yield f"### {title}\n"
                rows = _coded((q.name, q.meaning, q.unit) for q in quantities)
                yield from _table(("name", "meaning", "unit"), rows)
        yield f"### Gaits\n\n{', '.join(f'`{gait}`' for gait in kind.gaits)}.\n"


def statuses() -> Iterator[str]:
    """The statuses of a row, with what each means for its result."""
    from gaitsweep.status import Status

    rows = [(f"`{status.name}`", status.verdict.value, _escaped(status.sentence)) for status in Status]
    yield from _table(("status", "verdict", "meaning"), rows)


DESCRIBED = {
    describe.__name__: describe
    for describe in (
        commands,
        job_fields,
        axes,
        runs,
        figures,
        style,
        numerics,
        engine,
        search,
        sensitivity,
        measures,
        models,
        pictures,
        explorer,
        statuses,
    )
}


def _schema() -> dict[str, Any]:
    from gaitsweep.fitting.schema import schema

    return schema()


def _part(
    schema: Described, kind: str | None = None, *, heading: str = "###", label: str = ""
) -> Iterator[str]:
    """The section of a part of a job: its kind, what it is, its fields."""
    title = kind or str(schema["title"]).lower()
    if label:
        yield f"({label}-{title.replace('_', '-')})="
    yield f"{heading} {title}\n\n{_escaped(_sentence(schema.get('description', '')))}\n"
    yield from _fields(schema)


def _fields(schema: Described) -> Iterator[str]:
    """The fields of a part of a job, but for its kind."""
    required = schema.get("required", [])
    fields = {name: field for name, field in schema["properties"].items() if name != "kind"}
    rows = [_field(name, field, required) for name, field in fields.items()]
    yield from _table(_FIELD_COLUMNS, rows)


def _field(name: str, schema: Described, required: Sequence[str]) -> tuple[str, str, str, str]:
    if name in required:
        default = "needed"
    elif schema.get("default") is None:
        default = ""
    else:
        default = f"`{schema['default']}`".replace("`True`", "`true`").replace("`False`", "`false`")
    return f"`{name}`", _escaped(schema.get("description", "")), _type(schema), default


def _type(schema: Described) -> str:
    """Allowed values of a field, in words; numbers may be arithmetic, which a schema writes as text."""
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    if "anyOf" in schema or "oneOf" in schema:
        kinds = [
            _type(kind) for kind in schema.get("anyOf", schema.get("oneOf", ())) if kind.get("type") != "null"
        ]
        return " or ".join(dict.fromkeys(kinds)).replace("fields or fields", "fields")
    kinds = schema.get("type", "object" if "$ref" in schema else "")
    if isinstance(kinds, list):
        if "string" in kinds and len(kinds) > 1:
            kinds = [kind for kind in kinds if kind != "string"]
        return " or ".join(dict.fromkeys(_TYPES[kind] for kind in kinds))
    if kinds == "array" and isinstance(items := schema.get("items"), Mapping) and _type(items):
        return {"number": "numbers", "text": "names", "whole number": "whole numbers"}.get(
            _type(items), "list"
        )
    return _TYPES.get(kinds, "")


def _example(part: Mapping[str, Any]) -> Iterator[str]:
    """A part of a job as YAML, with what stands under its first key in one line."""
    [(name, inner)] = part.items()
    lines = [f"- {_inline(item)}" for item in inner] if isinstance(inner, list) else [_inline(inner)]
    text = f"{name}: {lines[0]}" if isinstance(inner, Mapping) else "\n  ".join([f"{name}:", *lines])
    yield f"```yaml\n{text}\n```\n"


def _inline(part: Any) -> str:
    text = yaml.safe_dump(part, default_flow_style=True, sort_keys=False, width=10**6, allow_unicode=True)
    return text.strip()


def _sentence(text: str) -> str:
    """A description as a sentence, without what a docstring adds for the readers of the source."""
    text = " ".join(text.split("\n\n")[0].split())
    text = text[:1].upper() + text[1:]
    return text if not text or text.endswith((".", ":")) else f"{text}."


def _escaped(text: str) -> str:
    """Text with what Markdown would read as emphasis, a link or HTML taken literally, outside of code."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part[:1] == "`" else re.sub(r"([*_<>\[\]$|~])", r"\\\1", part) for part in parts)


def _coded(rows: Iterable[Sequence[str]]) -> list[tuple[str, ...]]:
    """Rows whose first entry is a name."""
    return [(f"`{first}`", *map(_escaped, rest)) for first, *rest in rows]


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """A table, without the columns that are empty in each row."""
    kept = [n for n in range(len(columns)) if any(row[n] for row in rows)]
    lines = [[columns[n] for n in kept], ["---"] * len(kept), *([row[n] for n in kept] for row in rows)]
    yield "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _replace(app: Sphinx, page: str, source: list[str]) -> None:
    def written(mark: re.Match[str]) -> str:
        if mark["name"] not in DESCRIBED:
            raise ExtensionError(f"{page}: nothing is described as {mark['name']}: {', '.join(DESCRIBED)}.")
        return "\n".join(DESCRIBED[mark["name"]]())

    source[0] = MARK.sub(written, source[0])


def on_a_forge(name: str) -> str:
    """What a function of `DESCRIBED` writes, for a forge: with anchors of HTML, and without pictures."""
    text = re.sub(r"^!\[.*\n", "", "\n".join(DESCRIBED[name]()), flags=re.MULTILINE)
    text = re.sub(r"^\(([a-z-]+)\)=$", r'<a id="\1"></a>\n', text, flags=re.MULTILINE)
    text = re.sub(r"\n{3,}", "\n\n", text)
    return f"<!-- described: {name} -->\n\n{text}\n<!-- end: {name} -->"


def written_pages() -> Iterator[tuple[Path, str]]:
    """The pages with references that are stored, and their texts by today's package."""
    for page in sorted(Path(__file__).parents[1].glob("*.md")):
        text = page.read_text(encoding="utf-8")
        now = MARK.sub(lambda mark: on_a_forge(mark["name"]) if mark["stored"] else mark[0], text)
        if any(mark["stored"] for mark in MARK.finditer(text)):
            yield page, now


def _always_read(app: Sphinx, env: Any, added: set[str], changed: set[str], removed: set[str]) -> set[str]:
    """Pages that are written from the package are read in each build, since the package may have changed."""
    return {page for page in env.found_docs if MARK.search(env.doc2path(page).read_text(encoding="utf-8"))}


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the replacement."""
    app.connect("source-read", _replace)
    app.connect("env-get-outdated", _always_read)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    changed = [(page, text) for page, text in written_pages() if page.read_text(encoding="utf-8") != text]
    if "--check" in sys.argv[1:]:
        sys.exit(", ".join(page.name for page, _ in changed) or None)
    for changed_page, page_text in changed:
        changed_page.write_text(page_text, encoding="utf-8")
