"""How the templates of pages are filled."""

from __future__ import annotations

import functools
from typing import NamedTuple

import jinja2
from skd_sim.options.registry import Registry

SECTIONS = Registry("section of reports", "skd.report_sections", {})
"""Functions of extensions that are given the results of a page and return a `Section`, or None."""


class Section(NamedTuple):
    """A section that an extension adds to the page of results.

    Attributes:
        name: anchor of the section, which its HTML has as `id`.
        title: what the page's navigation calls it.
        html: its HTML.
    """

    name: str
    title: str
    html: str


def filled(package: str, name: str, **values: object) -> str:
    """Return a template of a package with values put in: they are escaped, and all that it names has to be there."""
    return _environment(package).get_template(name).render(**values)


@functools.cache
def _environment(package: str) -> jinja2.Environment:
    loader = jinja2.PackageLoader(package)
    return jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
