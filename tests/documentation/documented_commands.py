"""The shell commands of the documentation, as a shell reads them.

Each block is run by bash in a folder that looks like the top of a checkout, in which every program is one that writes
down how it was called and does nothing: so loops, quotes, braces and variables are the shell's own business.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from common import PATIENCE
from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
SHELLS = {"bash", "console", "sh", "shell"}
FOREIGN = (
    *("colcon", "cyclonedx-py", "dask", "docker", "git", "pip-audit", "python", "python3"),
    *("ros2", "rosdep", "ssh-keygen", "sudo", "tmux"),
)
"""Programs that the documentation calls and that do not lie in the checkout."""
_INTERPRETERS = (
    *(".venv/bin/python", ".venv-jazzy/bin/python", ".venv/bin/pip"),
    *(".venv-commonroad/bin/python", ".venv-commonroad/bin/skd"),
)
_READ = ("ros_ws/install/setup.bash", ".venv-jazzy/bin/activate", "manifest.sha256")
_RECORDER = """#!/bin/sh
{ printf 'PYTHONPATH=%s\\0' "$PYTHONPATH"; pwd | tr '\\n' '\\0'; printf '%s\\0' "$0" "$@"; printf '\\036'; } >>"$CALLS"
[ "${0##*/} $1" != "git clone" ] || ln -sfn . "$3"
"""


@dataclass(frozen=True)
class Block:
    """A code block of a document.

    Attributes:
        document: path from the top of the repository.
        line: its first line, from 1.
        language: what stands behind the fence; empty where nothing does; None for an indented block.
        text: its lines.
    """

    document: str
    line: int
    language: str | None
    text: str

    @property
    def is_shell(self) -> bool:
        """Whether it holds commands: what is indented does."""
        return self.language is None or self.language in SHELLS

    def __str__(self) -> str:
        return f"{self.document}:{self.line}"


@dataclass(frozen=True)
class Call:
    """How a program is called by a block.

    Attributes:
        block: where.
        program: as a path from the top of the checkout, or as a name.
        words: its arguments.
        python_path: PYTHONPATH of this call.
        folder: where it is run, from the top of the checkout.
    """

    block: Block
    program: str
    words: tuple[str, ...]
    python_path: str
    folder: str

    def __str__(self) -> str:
        return " ".join((self.program, *self.words))


def documents() -> list[Path]:
    """Every document that a reader may take commands from."""
    return [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "requirements" / "README.md",
        *sorted((ROOT / "docs").rglob("*.md")),
        *sorted((ROOT / "examples").rglob("README.md")),
    ]


def blocks(document: Path) -> Iterator[Block]:
    """Yield the code blocks of a document."""
    name = str(document.relative_to(ROOT))
    for token in MarkdownIt().parse(document.read_text(encoding="utf-8")):
        if token.type in ("fence", "code_block"):
            line = (token.map or [0])[0] + 1
            yield Block(name, line, token.info.strip() if token.type == "fence" else None, token.content)


def make_checkout(folder: Path) -> Path:
    """Make a folder with every program that the documentation may call, each of which does nothing.

    Returns:
        The folder of those that are found by their names.
    """
    found = folder / "programs"
    scripts = [path for path in (ROOT / "scripts").iterdir() if os.access(path, os.X_OK)]
    programs = [*(found / name for name in FOREIGN), *(folder / "scripts" / path.name for path in scripts)]
    for program in (*programs, *(folder / name for name in _INTERPRETERS)):
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(_RECORDER)
        program.chmod(0o755)
    (folder / "skd_results" / "first").mkdir(parents=True)
    for name in _READ:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return found


def calls(shell: Sequence[Block], folder: Path) -> dict[Block, list[Call]]:
    """Return how each block calls which programs.

    Raises:
        AssertionError: a block is no good shell, or calls a program that nobody knows.
    """
    found = make_checkout(folder)
    log = folder / "calls"
    environment = {"PATH": f"{found}:/usr/bin:/bin", "CALLS": str(log), "HOME": str(folder)}
    said: dict[Block, list[Call]] = {}
    for block in shell:
        log.write_bytes(b"")
        done = subprocess.run(
            ["bash", "-eu", "-o", "pipefail", "-c", block.text],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, ""), f"{block}: {done.stderr}"
        said[block] = []
        for entry in log.read_text(encoding="utf-8").split("\036")[:-1]:
            path, place, program, *words = entry.split("\0")[:-1]
            name = Path(place, program).resolve()
            within = name.relative_to(folder) if name.is_relative_to(folder) else name
            said[block].append(
                Call(
                    block,
                    within.name if within.parts[0] == "programs" else str(within),
                    tuple(words),
                    path.removeprefix("PYTHONPATH="),
                    os.path.relpath(Path(place).resolve(), folder),
                )
            )
    return said
