"""The documentation as a site: built without a warning, complete, and asking nobody for anything."""

import ast
import html
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import chromium
from common import run_program
from packaging_support import PYTHON_PACKAGES, ROOT, SOURCE
from skd_evaluator.cli.main import commands_of, make_parser

OPENED = ("index", "tutorial", "metrics", "commands", "api/skd_evaluator.metrics")
PROGRAMS = {"cli", "nodes", "ros", "ros_environment"}  # what is run, and not imported


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("documentation") / "site"
    # Where there is a black, which leaves signatures as they are, ruff is not started for each of 700 of them.
    black = "InvalidInput = Mode = dict\n\ndef format_str(text, mode):\n    return text\n"
    (folder.parent / "black.py").write_text(black)
    variables = {"SKD_ENV": str(Path(sys.executable).parent), "PYTHONPATH": str(folder.parent)}
    command = (ROOT / "scripts" / "docs", "build", "--strict", "--site-dir", folder)
    done = run_program(*command, NO_MKDOCS_2_WARNING="1", **variables)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, str]:
    return {str(path.relative_to(site)): path.read_text(encoding="utf-8") for path in site.rglob("*.html")}


def test_every_document_is_a_page(pages: dict[str, str]):
    documents = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
    documents |= {str(path.relative_to(ROOT)) for path in (ROOT / "examples").glob("*/README.md")}
    wanted = {re.sub(r"(README|index)\.md$", "index.html", name).replace(".md", ".html") for name in documents}
    assert wanted <= set(pages)
    assert "how safe is a self-driving car" in pages["index.html"]  # the README


def test_no_page_names_what_it_would_fetch_elsewhere(site: Path, pages: dict[str, str]):
    for name, page in pages.items():
        loaded = re.findall(r"<(?:script|img|iframe|source|link)\b[^>]*?(?:src|href)=\"([^\"]*)\"", page)
        assert [one for one in loaded if re.match(r"(https?:)?//", one)] == [], name
    for sheet in site.rglob("*.css"):
        assert re.findall(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", sheet.read_text("utf-8")) == [], sheet


def test_formulas_are_drawn_by_the_build(pages: dict[str, str]):
    for name in ("metrics", "how_it_works"):
        text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        source = re.sub(r"`[^`\n]*`|^ {4}.*$", "", text, flags=re.MULTILINE)  # without code
        wanted = len(re.findall(r"\$\$.*?\$\$|\$[^$\n]+\$", source, re.DOTALL))
        assert pages[f"{name}.html"].count("<math") == wanted > 10, name
    assert not any("arithmatex" in page for page in pages.values())


def test_the_command_line_is_there_whole(pages: dict[str, str]):
    page = html.unescape(pages["commands.html"])
    for name, parser in commands_of(make_parser()).items():
        assert f'id="skd-{name}"' in page
        section = page.split(f'id="skd-{name}"')[1].split("<h2")[0]
        for action in parser._actions:
            for flag in action.option_strings:
                assert flag in ("-h", "--help", "--help-all") or f"<code>{flag}" in section, (name, flag)


def public() -> Iterator[tuple[str, str]]:
    """Yield each module that can be imported, with a function or class of it."""
    for package in PYTHON_PACKAGES:
        top = SOURCE / package / package
        for module in top.rglob("[!_]*.py"):
            within = module.relative_to(top)
            if not PROGRAMS & set(within.parts):
                name = ".".join((package, *within.with_suffix("").parts))
                for node in ast.parse(module.read_text(encoding="utf-8")).body:
                    if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                        yield name, node.name


def test_python_is_there_whole(pages: dict[str, str]):
    found = list(public())
    assert len(found) > 500
    for module, name in found:
        page = pages[f"api/{module.rpartition('.')[0]}.html"]
        assert f'id="{module}.{name}"' in page, (module, name)
    sections = re.compile(r"<p>(?:[^<]*\n)?(Args|Attributes|Raises|Returns|Yields):")
    assert {name: sections.findall(page) for name, page in pages.items() if sections.search(page)} == {}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as opened:
        yield opened


@pytest.mark.parametrize(("width", "scheme", "opened"), [(400, "light", OPENED), (1400, "dark", OPENED[:3])])
def test_pages_in_a_browser(site: Path, browser: Any, width: int, scheme: str, opened: tuple[str, ...]):
    """Nothing is fetched but the site's own files, nothing fails, nothing is wider than the window, all is drawn."""
    page = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme).new_page()
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    for name in opened:
        page.goto((site / f"{name}.html").as_uri())
        assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth"), name
        assert page.evaluate("[...document.images].every(one => one.complete && one.naturalWidth > 0)"), name
        heights = page.evaluate("[...document.querySelectorAll('math')].map(one => one.getBoundingClientRect().height)")
        assert min(heights, default=1) > 0, name
        assert heights or name != "metrics"
    assert said == []
    assert [url for url in asked if not url.startswith(site.as_uri())] == []


def test_search_works_where_the_site_is_opened_as_a_file(site: Path, browser: Any):
    page = browser.new_page()
    page.goto((site / "index.html").as_uri())
    page.click(".md-search__input")
    page.locator(".md-search__input").press_sequentially("Eiter Mannila")
    page.locator(".md-search-result__item").first.wait_for(state="visible")
    found = page.locator(".md-search-result__item h1").all_inner_texts()
    assert "What the numbers mean" in found
