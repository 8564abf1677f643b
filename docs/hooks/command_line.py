"""Reference of the command line, out of its parsers."""

from __future__ import annotations

import argparse
import html
from collections.abc import Iterator

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page
from skd_evaluator.cli.main import commands_of, make_parser

_COMMANDS = "commands.md"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Add the list of commands, and the options of each."""
    if page.file.src_uri != _COMMANDS:
        return markdown
    return "\n".join([markdown, *_command_line()])


def _command_line() -> Iterator[str]:
    program = make_parser(["--help-all"])
    yield f"\n```text\n{program.format_help()}```\n"
    for name, parser in commands_of(program).items():
        yield f"\n## skd {name}\n\n{_prose(parser.description or '')}\n"
        for group in parser._action_groups:
            actions = [action for action in group._group_actions if not isinstance(action, argparse._HelpAction)]
            if not actions:
                continue
            if group.title not in ("options", "positional arguments"):
                yield f"\n**{str(group.title).capitalize()}**\n"
            yield "\n| | |\n|---|---|"
            formatter = parser._get_formatter()
            for action in actions:
                text = _prose(formatter._expand_help(action) if action.help else "")
                yield f"| {_invocation(action, formatter)} | {text} |"


def _invocation(action: argparse.Action, formatter: argparse.HelpFormatter) -> str:
    if not action.option_strings:
        return f"`{formatter._format_args(action, str(action.dest).upper())}`"
    value = "" if action.nargs == 0 else f" {formatter._format_args(action, action.dest.upper())}"
    return ", ".join(f"`{flag}{value}`" for flag in action.option_strings).replace("|", "\\|")


def _prose(text: str) -> str:
    for character in "\\*_[]`|~$":
        text = text.replace(character, f"\\{character}")
    return html.escape(text, quote=False)
