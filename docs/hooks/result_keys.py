"""Reference of the keys of assessment.json, out of its schema."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page
from skd_evaluator.assessment.files.assessment_json import assessment_schema

_PAGE, _PLACE = "files.md", "<!-- keys of assessment.json -->"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put the tables where the page has their place."""
    return markdown.replace(_PLACE, "\n".join(_tables())) if page.file.src_uri == _PAGE else markdown


def _tables() -> Iterator[str]:
    schema = assessment_schema()
    yield from _table(schema)
    for name, one in schema["$defs"].items():
        if "properties" in one:
            yield f"\n**{name}**\n"
            yield from _table(one)


def _table(schema: Mapping[str, Any]) -> Iterator[str]:
    yield "| key | type | is |\n|---|---|---|"
    for path, one in _keys(schema, ""):
        yield f"| `{path}` | {_type(one)} | {html.escape(one['description'], quote=False)} |"


def _keys(node: Any, path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for key, one in node.get("properties", {}).items():
        yield f"{path}{key}", one
        yield from _keys(one, f"{path}{key}.")
    for key, end in (("items", ""), ("additionalProperties", "NAME.")):
        if isinstance(node.get(key), Mapping):
            yield from _keys(node[key], f"{path}{end}")
    for one in node.get("anyOf", ()):
        yield from _keys(one, path)


def _type(node: Mapping[str, Any]) -> str:
    if "$ref" in node:
        return str(node["$ref"]).rpartition("/")[2].replace("_", " ")
    if "anyOf" in node:
        return " or ".join(map(_type, node["anyOf"]))
    kinds = node.get("type", "")
    return " or ".join(kinds) if isinstance(kinds, list) else str(kinds)
