"""Extension of autodoc: arguments that are described in annotations, and short names of classes."""

from __future__ import annotations

import inspect
import re
import typing
from typing import Any

import gallery
from docutils import nodes
from matplotlib.figure import Figure
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.domains.python import PythonDomain
from sphinx.util.nodes import make_refnode

# Modules with figures, whose arguments are described in their annotations.
_FIGURES = ("gaitsweep.plot", "gaitsweep.papers")


def _plain_annotations(app: Sphinx, documented: Any, bound_method: bool) -> None:
    """Show an argument's type without what `Annotated` adds: descriptions stand among the arguments."""
    function = inspect.unwrap(documented)
    if not inspect.isfunction(function) or not function.__module__.startswith(_FIGURES):
        return
    hints = typing.get_type_hints(function, localns={"Figure": Figure})
    documented.__annotations__ = function.__annotations__ = hints


def _signature(
    app: Sphinx,
    what: str,
    name: str,
    documented: Any,
    options: Any,
    signature: str | None,
    returned: str | None,
) -> tuple[str | None, str | None]:
    """Show an alias by its name within a union too, and the parts of a job by their fields."""

    def named(text: str | None) -> str | None:
        return text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text)

    if what == "class" and issubclass(documented, BaseModel):
        fields = sorted(_fields(documented).items(), key=lambda field: not field[1].is_required())
        arguments = [_argument(key, each) for key, each in fields]
        return f"(*, {', '.join(arguments)})", None
    return named(signature), named(returned)


def _argument(name: str, field: FieldInfo) -> str:
    if field.is_required():
        return name
    default = field.get_default(call_default_factory=True)
    return f"{name}={'...' if isinstance(default, BaseModel) else repr(default)}"


def _fields(part: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a part of a job, but for its kind, and for those of a style, which have a section."""
    from gaitsweep.plot.figure_style import STYLE_FIELDS, FigureStyle

    left_out = {"kind", *(STYLE_FIELDS if issubclass(part, FigureStyle) else ())}
    return {name: field for name, field in part.model_fields.items() if name not in left_out}


def _returns_without_type(
    app: Sphinx, what: str, name: str, documented: Any, options: Any, lines: list[str]
) -> None:
    """Keep napoleon from taking what stands before the first colon for a type: none is written there."""
    if what == "property" and lines:
        lines[0] = f": {lines[0]}"
    for number, line in enumerate(lines[:-1]):
        if line.strip() == "Returns:":
            first = lines[number + 1]
            indent = len(first) - len(first.lstrip())
            lines[number + 1] = f"{first[:indent]}: {first[indent:]}"


def _described_fields(
    app: Sphinx, what: str, name: str, documented: Any, options: Any, lines: list[str]
) -> None:
    """Add the fields of a figure, a run kind or a job to the arguments of its docstring."""
    from gaitsweep.plot import FIGURES

    kind = name.rpartition(".")[2]
    if what == "function" and name.startswith("gaitsweep.plot.") and kind in FIGURES:
        fields = {key: each for key, each in _fields(FIGURES[kind]).items() if key != "name"}
    elif what == "class" and issubclass(documented, BaseModel):
        fields = _fields(documented)
        del lines[lines.index("Fields:") :]  # what `help` shows
    else:
        return
    if lines and lines[-1]:
        lines.append("")
    lines += [f":param {key}: {_escaped(each.description or '')}" for key, each in fields.items()]
    if what == "function" and kind in gallery.ENTRIES:
        lines += ["", f".. image:: /build/gallery/{kind}.png", f"   :alt: A figure of kind {kind}"]


def _escaped(text: str) -> str:
    """Text with what reStructuredText would read as markup taken literally."""
    text = re.sub(r"([*_|])", r"\\\1", text)
    return text if text.endswith(".") else f"{text}."


def _public_name(
    app: Sphinx, env: Any, node: pending_xref, contnode: nodes.TextElement
) -> nodes.reference | None:
    """Link a name of a class to the place where it is documented under its public name."""
    if node.get("refdomain") != "py":
        return None
    domain = env.get_domain("py")
    assert isinstance(domain, PythonDomain)
    short = node["reftarget"].rpartition(".")[2]
    found = [
        (name, each)
        for name, each in domain.objects.items()
        if name.rpartition(".")[2] == short and each.objtype in ("class", "exception")
    ]
    if len(found) != 1:
        return None
    [(name, each)] = found
    return make_refnode(app.builder, node["refdoc"], each.docname, each.node_id, contnode, name)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the handlers; descriptions come after napoleon has read the docstring."""
    app.connect("autodoc-before-process-signature", _plain_annotations)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-process-docstring", _returns_without_type, priority=100)
    app.connect("autodoc-process-docstring", _described_fields, priority=900)
    app.connect("missing-reference", _public_name)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
