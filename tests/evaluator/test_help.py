"""The command line: help, a light start."""

import argparse
import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_support import one_line
from common import run_skd
from skd_evaluator.cli.main import Parser, commands_of, make_parser

SOURCES = Path(__file__).parents[2] / "ros_ws" / "src"
LONGEST = 25  # words of a sentence
PRIVATE = re.compile(
    r"\b(asked|told|led|lot|somebody|whoever|wanted|stray\w*|attempt\w*|struck|bent|bend\w*|keeper|"
    r"foretold|foresight|closeness|encounter\w*|deform\w*)\b",
    re.IGNORECASE,
)
"""Words that a reader of the field would have to learn, for trial, deviation, sample, system under test and others."""


@pytest.fixture
def commands() -> Iterator[dict[str, argparse.ArgumentParser]]:
    """The parsers of all commands, whose help has every option."""
    yield commands_of(make_parser(["--help-all"]))
    Parser.everything = False


def messages() -> Iterator[tuple[str, str]]:
    """Place and text of all that the packages can say but docstrings; what is filled in stands as one word."""
    for path in sorted(SOURCES.rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        texts = [one for one in nodes if isinstance(one, ast.JoinedStr)]
        within = {id(part) for one in texts for part in ast.walk(one) if part is not one}
        silent = within | {id(one.value) for one in nodes if isinstance(one, ast.Expr)}
        for one in nodes:
            if isinstance(one, ast.Constant | ast.JoinedStr) and id(one) not in silent:
                parts = one.values if isinstance(one, ast.JoinedStr) else [one]
                words = [part.value if isinstance(part, ast.Constant) else "X" for part in parts]
                if all(isinstance(word, str) for word in words) and not "".join(words).startswith(
                    ("\nCREATE", "own_contact")
                ):
                    yield f"{path.name}:{one.lineno}", "".join(words)


def too_long(text: str, ends: str) -> list[str]:
    return [one for one in re.split(rf"(?<=[{ends}])\s", text) if len(one.split()) > LONGEST]


@pytest.mark.parametrize("words", [["--version"], ["assess", "--help"]])
def test_help_that_cannot_be_written_is_an_error_in_a_line(here, words):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "skd_evaluator", *words], cwd=here, stdout=full, stderr=subprocess.PIPE, text=True
        )
    one_line(done, 1, ": error: ", "No space left on device")


def test_every_command_explains_itself_in_few_options(capsys):
    assert run_skd("--help") == 0
    names = re.findall(r"^  (\w+) ", capsys.readouterr().out, re.MULTILINE)
    assert {"assess", "episode", "compare"} <= set(names)
    assert len(names) == len(set(names)) <= 18
    assert run_skd("--help-all") == 0
    everything = re.findall(r"^  (\w+) ", capsys.readouterr().out, re.MULTILINE)
    assert set(everything) - set(names) >= {"probe", "sweep"}
    assert set(everything) == set(commands_of(make_parser()))
    for name in everything:
        assert run_skd(name, "--help") == 0, name
        said = capsys.readouterr().out
        assert f"usage: skd {name}" in said
        assert len(re.findall(r"^  -", said, re.MULTILINE)) <= 25, name
        assert run_skd(name, "--help-all") == 0, name
        assert len(capsys.readouterr().out) >= len(said) - 60  # of the line that says how many there are


def test_skd_alone_prints_its_help(capsys):
    assert run_skd() == 0
    alone = capsys.readouterr()
    assert run_skd("--help") == 0
    assert alone == capsys.readouterr()
    assert "assess" in alone.out


def test_no_word_of_pages_and_reports_is_private():
    pages = [*SOURCES.rglob("*.j2"), *SOURCES.rglob("templates/*.js"), *(SOURCES.parents[1] / "docs").glob("*.md")]
    pages.append(SOURCES.parents[1] / "README.md")
    assert len(pages) > 25
    for page in pages:
        text = page.read_text(encoding="utf-8").replace("told apart", "").replace("Told apart", "")
        assert PRIVATE.findall(text) == [], page


def test_no_sentence_is_long_and_no_word_private(commands):
    texts = [(name, command.description or "") for name, command in commands.items()]
    for name, command in commands.items():
        texts += [(name, command._get_formatter()._expand_help(one)) for one in command._actions if one.help]
    assert len(texts) > 300
    assert [(name, one) for name, text in texts for one in too_long(text, ".!?")] == []
    assert [(name, text) for name, text in texts if PRIVATE.search(text)] == []
    said = list(messages())
    assert len(said) > 5000
    assert [(place, one) for place, text in said for one in too_long(text, ".!?;:")] == []
    sentences = [(place, text) for place, text in said if len(text.split()) > 2]
    assert [(place, text) for place, text in sentences if PRIVATE.search(text.replace("told apart", ""))] == []


@pytest.mark.parametrize(
    ("program", "without"),
    [
        ("import skd_evaluator.cli.assessment", "scipy.special scipy.optimize matplotlib vl_convert"),
        ("from skd_evaluator.cli.main import make_parser; make_parser()", "numpy numba pydantic rich yaml"),
        ("from skd_evaluator.cli.main import main; main(['compare', '--difference', '0.5'])", "matplotlib"),
    ],
    ids=["assess", "help", "plan"],
)
def test_a_start_imports_no_library_that_it_does_not_need(program: str, without: str) -> None:
    said = f"import sys\n{program}\nprint([name for name in {without.split()} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
