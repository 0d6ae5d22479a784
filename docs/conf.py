"""Configuration of Sphinx, which builds the documentation: `make docs`.

The source folder is the repository itself, so that links between README, docs and notebooks are the same ones
on a forge and on the site.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from docutils import nodes

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS / "extensions"), str(DOCS.parent)]
os.environ.setdefault("JAX_PLATFORMS", "cpu")  # models are only described here

import gaitsweep  # noqa: E402 - needs the path above

project = "gaitsweep"
author = "gaitsweep authors"
copyright = "gaitsweep authors, Apache-2.0"
version = release = gaitsweep.__version__

root_doc = "docs/index"
include_patterns = ["docs/*.md", "notebooks/*.ipynb", "CHANGELOG.md", "CONTRIBUTING.md"]
exclude_patterns = [".*", "build", "results", "gaitsweep", "tests", "benchmarks", "sweeps", "configs"]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "described_package",
    "gallery",
    "home_explorer",
    "mathml",
    "python_objects",
]

myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_inline"]
myst_heading_anchors = 4
default_role = "code"  # what stands between single backticks in docstrings
# Stored outputs are shown: tests/runs/test_notebooks.py runs each notebook and compares them.
nb_execution_mode = "off"
nb_merge_streams = True  # one block of output, however often it was written

autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_type_aliases = {name: name for name in ("AnyModel", "ArrayLike", "Rows", "Scalar", "SectionPoints")}
# Classes of other projects: their inventories would have to be fetched, and the build needs no network.
nitpick_ignore_regex = [
    (
        r"py:.*",
        r"(collections|jax|jaxlib|jaxtyping|matplotlib|np|numpy|pandas|pathlib|pd|pydantic|types|typing|xarray)\..*",
    ),
    (r"py:class", r"Path|Client|BaseModel|ndarray|Float"),
    (r"py:class", r"'[\w ]+'"),  # names of an array's axes
    # Names of unions in signatures, which the text beside them explains.
    (
        r"py:class",
        r"AnyModel|ArrayLike|Rows|Scalar|SectionPoints|(gaitsweep\..*)?(Progress|ModelT|T|FigureKind|Angles|Kind|Profile)",
    ),
]
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 88
add_module_names = False
toc_object_entries = True
toc_object_entries_show_parents = "hide"

smartquotes = False
highlight_language = "none"  # of blocks that name no language: they are commands and output

html_theme = "pydata_sphinx_theme"
html_title = f"gaitsweep {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = ["copy.js"]
html_favicon = "static/favicon.svg"
html_extra_path = ["extra"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # it fetches pages, which browsers refuse for a site opened from disk
html_math_renderer = "mathml"
html_sidebars = {
    page: [] for page in ("docs/index", "docs/start", "docs/concepts", "docs/gallery", "search", "genindex")
}
html_theme_options = {
    "logo": {"text": f"gaitsweep {release}"},
    "show_prev_next": True,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "show_toc_level": 2,
    "navigation_depth": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
}

# Words that readers search for, of pages that say it in other words.
SEARCH_WORDS = {
    "docs/guides": "sample, latin, hypercube, units, gaussian, restart, resume, floquet",
    "docs/reference": "cite, citation, bibtex, doi, version",
    "docs/own_figure": "colour, color, palette, colormap, style, size, font, pdf, svg",
    "docs/start": "csv, export, excel, dataframe, install",
    "docs/search": "fit, optimise, optimize, calibrate, search",
    "docs/processes": "joblib, multiprocessing, parallel, jupyter",
}


def setup(app: Any) -> None:
    """Give pages the keywords that the search of the site finds."""

    def add(app: Any, doctree: nodes.document) -> None:
        if words := SEARCH_WORDS.get(app.env.docname):
            doctree.insert(0, nodes.meta(name="keywords", content=words))

    app.connect("doctree-read", add)
