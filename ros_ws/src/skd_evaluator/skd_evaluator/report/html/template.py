"""How the templates of pages are filled."""

from __future__ import annotations

import jinja2


def filled(package: str, name: str, **values: object) -> str:
    """Return a template of a package with values put in: they are escaped, and all that it names has to be there."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name).render(**values)
