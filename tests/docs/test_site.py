"""The site builds without a warning, and its references are complete."""

from __future__ import annotations

import html
import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

import gaitsweep as gs
from gaitsweep.cli.commands import app
from gaitsweep.fitting.schema import schema
from gaitsweep.papers.ambe2021 import theory
from gaitsweep.plot import FIGURES
from tests.support.browser import browser, program

pytestmark = pytest.mark.slow  # half a minute: Sphinx reads each page and imports the package

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; a warning, such as a link that leads nowhere, is an error."""
    pytest.importorskip("myst_nb")
    out = tmp_path_factory.mktemp("site")
    options = ["-W", "--keep-going", "-n", "-q", "-b", "html", "-c", "docs", "-d", str(out / "doctrees")]
    command = [sys.executable, "-m", "sphinx", *options, ".", str(out / "html")]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert not built.stderr
    return out / "html"


def documented(site: Path) -> set[str]:
    """The names of Python objects in the site's inventory."""
    inventory = (site / "objects.inv").read_bytes().split(b"\n", 4)
    lines = zlib.decompress(inventory[4]).decode().splitlines()
    return {line.split()[0] for line in lines if re.match(r"\S+ py:", line)}


def text(page: Path) -> str:
    """The text of a page, without its markup."""
    return html.unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")))


def test_every_public_name_is_in_the_api_reference(site: Path) -> None:
    names = {f"gaitsweep.{name}" for name in vars(gs)["__all__"]}
    analyses = vars(gs.analyses)["__all__"]
    functions = (name for name in analyses if callable(getattr(gs.analyses, name)))
    names |= {f"gaitsweep.analyses.{name}" for name in functions} - {"gaitsweep.analyses.basins"}
    of_theory = (name for name, value in vars(theory).items() if callable(value))
    names |= {f"gaitsweep.papers.ambe2021.theory.{name}" for name in of_theory}
    names |= {f"gaitsweep.plot.{kind}" for kind in FIGURES}
    # these two are the functions of the package itself
    assert names - {"gaitsweep.analyses.hysteresis"} <= documented(site)


def test_every_command_is_in_the_command_reference(site: Path) -> None:
    page = text(site / "docs/command_reference.html")
    assert "Default: []" not in page

    def check(group: TyperGroup, before: str) -> None:
        for name, command in group.commands.items():
            words = f"{before} {name}"
            assert f"\n{words}" in page or f"{words}#" in page, words
            if isinstance(command, TyperGroup):
                check(command, words)
                continue
            for parameter in command.params:
                assert (parameter.metavar or parameter.opts[0]) in page, (words, parameter.opts)

    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    check(group, "gaitsweep")


def test_every_field_and_quantity_is_in_the_references(site: Path) -> None:
    page = text(site / "docs/job_reference.html")
    described = schema()
    parts = [described, described["properties"]["search"], described["properties"]["sensitivity"]]
    for part in [*parts, *described["$defs"].values()]:
        for field in part["properties"]:
            assert re.search(rf"\b{field}\b", page), field
    page = text(site / "docs/model_reference.html")
    for name in gs.models.names():
        model = gs.models.find(name)()
        quantities = (*model.parameters, *model.initial_conditions, *model.observables, *model.signals)
        for quantity in quantities:
            assert quantity.name in page
            assert quantity.meaning.replace("`", "") in page, (name, quantity.name)


def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    """Scripts, styles, fonts and images are files of the site, so that it reads without a network."""
    for page in site.rglob("*.html"):
        source = page.read_text(encoding="utf-8")
        for link in re.findall(r"<(?:script|img|link|iframe)\b[^>]*?(?:src|href)=\"([^\"]+)\"", source):
            assert not re.match(r"(https?:)?//", link), (page.name, link)


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine (apt-get install chromium)")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_are_legible_in_both_schemes(site: Path, scheme: str) -> None:
    """Texts have a contrast of 4.5 : 1 (WCAG 2.2, AA); figures are drawn on a light ground."""
    with browser() as page:
        page.scheme(scheme)
        for name in ("docs/explorer", "docs/own_model", "docs/job_reference", "notebooks/your_own_model"):
            for width in (390, 1280):
                page.size(width, 900)
                page.call("Page.navigate", url=(site / f"{name}.html").as_uri())
                page.wait(f"document.readyState === 'complete' && {_THEME} === '{scheme}'")
                assert page.least_contrast() >= (4.5, ""), name
                grounds = page.evaluate(_GROUNDS)
                if scheme == "dark":
                    assert all(min(ground) > 200 and len(ground) == 3 for ground in grounds), name


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine (apt-get install chromium)")
def test_the_home_page_has_an_explorer_that_answers(site: Path) -> None:
    home = site / "docs/index.html"
    (name,) = re.findall(r'<iframe class="explorer" src="([^"]+)"', home.read_text(encoding="utf-8"))
    with browser() as page:
        page.call("Page.navigate", url=home.as_uri())
        page.wait("document.readyState === 'complete'")
        assert page.errors == []
        page.open(home.parent / name)
        chosen = "Number(document.querySelector('td[data-column=row]').textContent)"
        first = page.evaluate(chosen)
        page.press("ArrowRight")
        page.wait(f"{chosen} !== {first}")
        assert page.errors == []


@pytest.mark.skipif(program() is None, reason="no Chromium on this machine (apt-get install chromium)")
def test_the_search_finds_other_words_for_things(site: Path) -> None:
    """Each word finds the page that says how."""
    pages = {
        "cite": "reference", "colour": "own_figure", "color": "own_figure", "palette": "own_figure",
        "csv": "start", "export": "start", "step_limit": "concepts", "self-check": "reliability",
        "cluster": "clusters", "restart": "guides", "units": "guides", "gaussian": "guides",
        "floquet": "guides", "latin hypercube": "guides", "sobol": "job_reference", "xppaut": "other_tools",
    }  # fmt: skip
    links = "[...document.querySelectorAll('#search-results li a')].map(link => link.href)"
    with browser() as page:
        for word, wanted in pages.items():
            url = f"{(site / 'search.html').as_uri()}?q={word.replace(' ', '+')}"
            page.call("Page.navigate", url=url)
            page.wait(f"{links}.some(link => link.includes('docs/{wanted}.html'))")
        assert page.errors == []


_THEME = "document.documentElement.dataset.theme"
# behind each figure, the parts of its colour
_GROUNDS = """[...document.querySelectorAll('.bd-article img')].map(
    image => getComputedStyle(image).backgroundColor.match(/[\\d.]+/g).map(Number))"""
