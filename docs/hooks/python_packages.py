"""Reference of the Python packages: a page for each folder of modules, which mkdocstrings fills from docstrings."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

_SECTION = "Python"
_PACKAGES = ("skd_sim", "skd_adversary", "skd_evaluator")
_PROGRAMS = {"cli", "nodes", "ros", "ros_environment"}  # folders that are run, not imported


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages into the navigation's section."""
    for _, section in _sections(config.nav or []):
        if _SECTION in section:
            section[_SECTION] += [{_name(folder): _page(folder)} for folder in _folders(config)]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    for folder in _folders(config):
        files.append(File.generated(config, _page(folder), content="\n".join(_content(folder))))
    return files


def _sections(nav: list) -> Iterator[tuple[str, dict]]:
    for item in nav:
        for title, value in item.items() if isinstance(item, dict) else ():
            yield title, item
            if isinstance(value, list):
                yield from _sections(value)


def _folders(config: MkDocsConfig) -> Iterator[Path]:
    source = Path(config.config_file_path).parent / "ros_ws" / "src"
    for package in _PACKAGES:
        top = source / package / package
        for init in sorted(top.rglob("__init__.py")):
            if not _PROGRAMS & set(init.relative_to(top).parts) and any(_modules(init.parent)):
                yield init.parent


def _modules(folder: Path) -> Iterator[Path]:
    """Modules with something that a caller can use."""
    for module in sorted(folder.glob("[!_]*.py")):
        tree = ast.parse(module.read_text(encoding="utf-8"))
        if any(
            isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_") for node in tree.body
        ):
            yield module


def _name(folder: Path) -> str:
    """The dotted name of a folder's package, which lies in a folder of its first word."""
    words = folder.parts[folder.parts.index("src") + 2 :]
    return ".".join(words)


def _page(folder: Path) -> str:
    return f"api/{_name(folder)}.md"


def _content(folder: Path) -> Iterator[str]:
    name = _name(folder)
    yield f"# {name}\n"
    for module in _modules(folder):
        yield f"::: {name}.{module.stem}\n"
