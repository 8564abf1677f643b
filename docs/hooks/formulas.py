"""Formulas, which pages have in LaTeX, as MathML: browsers draw it without a script, and screen readers read it.

Not every machine has a font for mathematics: STIX Two Math (SIL Open Font License) is taken from the package ziamath.
"""

from __future__ import annotations

import html
import re
from importlib import resources

from math_core import LatexToMathML
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_FONT = "STIXTwoMath-Regular.ttf"
_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL
)  # as pymdownx.arithmatex leaves them
_CONVERTER = LatexToMathML()


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the font."""
    with resources.as_file(resources.files("ziamath.fonts") / _FONT) as path:
        files.append(File.generated(config, f"fonts/{_FONT}", content=path.read_bytes()))
    return files


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Draw the formulas of a page; one that is wrong ends the build."""
    return _FORMULA.sub(_mathml, content)


def _mathml(match: re.Match[str]) -> str:
    latex, display = html.unescape(match[2]).strip(), match[1] == "div"
    formula = _CONVERTER.convert_with_local_state(latex, displaystyle=display)
    return f'<div class="formula">{formula}</div>' if display else formula
