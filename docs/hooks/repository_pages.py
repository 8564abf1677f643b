"""Pages of the site that are no files of docs/: documents elsewhere in the repository, and sources that pages link to.

Documents link to each other as files of the repository, so that the links also work where there is no site. Here they
are turned into links of the site; a file that is no page gets one, with its text. A link that is called by the path of
a document is given that document's title.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_DOCS = "docs"
_SOURCES = "source"
_OUTSIDE = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "requirements/README.md")
_MOVED = {"README.md": "index.md"}
_LANGUAGES = {
    ".json": "json", ".msg": "text", ".py": "python", ".sh": "bash", ".toml": "toml", ".xml": "xml", ".yaml": "yaml",
    ".yml": "yaml",
}  # fmt: skip
_CODE = re.compile(r"^```.*?^```|^(?: {4}[^\n]*\n)+|`[^`\n]*`", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(\[(?:[\w./]+\.md)?|)(\]\()([^)\s#]+)((?:#[^)\s]*)?[^)]*\))")
_CELL_CODE = re.compile(r"(?<=<code>)[^<]*\\\|[^<]*(?=</code>)")
_EXTERNAL = re.compile(r"[a-z][a-z+.-]*:")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the documents outside docs/, and a page for each source that a document links to."""
    root = Path(config.config_file_path).parent
    for path in _documents(root):
        files.append(File.generated(config, _site_path(path), abs_src_path=str(root / path)))
    linked = set()
    for file in files.documentation_pages():
        text, path = file.content_string, _repository_path(file.src_uri)
        linked |= {target for target in _targets(text, path) if _site_path(target) not in files.src_uris}
    for target in sorted(linked):
        file = root / target
        if file.is_file() and not target.startswith(f"{_DOCS}/"):
            text = file.read_text(encoding="utf-8")
            language = _LANGUAGES.get(file.suffix) or ("bash" if text.startswith("#!/usr/bin/env bash") else "text")
            content = (
                f"---\nhide: [navigation, toc]\n---\n\n# {file.name}\n\n`{target}`\n\n~~~~{language}\n{text}\n~~~~\n"
            )
            files.append(File.generated(config, f"{_SOURCES}/{target}.md", content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between files of the repository into links of the site."""
    here = page.file.src_uri
    if here.startswith(f"{_SOURCES}/"):
        return markdown
    path, root = _repository_path(here), Path(config.config_file_path).parent

    def link(match: re.Match[str]) -> str:
        label, target = match[1], match[3]
        if _EXTERNAL.match(target):
            return match[0]
        there = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
        found = next(
            (uri for uri in (_site_path(there), f"{_SOURCES}/{there}.md") if uri in files.src_uris),
            None,
        )
        if found is None:
            if (root / there).is_dir() and (readme := f"{there}/README.md") in files.src_uris:
                found = readme
            else:
                raise PluginError(f"{path}: the link to {target} leads nowhere")
        if label.endswith(".md"):
            label = f"[{_title(files.src_uris[found])}"
        return f"{label}{match[2]}{posixpath.relpath(found, posixpath.dirname(here) or '.')}{match[4]}"

    return _outside_code(markdown, lambda text: _LINK.sub(link, text))


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Show a pipe in a table's code without the stroke that keeps it, elsewhere, from ending the cell."""
    cells = re.compile(r"<td.*?</td>", re.DOTALL)
    return cells.sub(lambda cell: _CELL_CODE.sub(lambda code: code[0].replace("\\|", "|"), cell[0]), content)


def _documents(root: Path) -> list[str]:
    examples = sorted((root / "examples").glob("*/README.md"))
    return ["README.md", *_OUTSIDE, *(str(path.relative_to(root)) for path in examples)]


def _site_path(path: str) -> str:
    """Where a file of the repository stands in the site, if it is a page or a picture of it."""
    return path.removeprefix(f"{_DOCS}/") if path.startswith(f"{_DOCS}/") else _MOVED.get(path, path)


def _repository_path(uri: str) -> str:
    moved = {there: here for here, there in _MOVED.items()}
    outside = uri in _documents(Path())[1:4] or uri.startswith(("examples/", "requirements/"))
    return moved.get(uri, uri if outside else f"{_DOCS}/{uri}")


def _targets(text: str, path: str) -> Iterator[str]:
    for match in _LINK.finditer(_CODE.sub("", text)):
        if not _EXTERNAL.match(match[3]):
            yield posixpath.normpath(posixpath.join(posixpath.dirname(path), match[3]))


def _title(file: File) -> str:
    return file.content_string.partition("\n")[0].removeprefix("# ").strip()


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    parts, end = [], 0
    for code in _CODE.finditer(text):
        parts += [change(text[end : code.start()]), code[0]]
        end = code.end()
    return "".join([*parts, change(text[end:])])
