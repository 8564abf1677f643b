"""What `skd replay` and `skd fit` say of damaged recordings."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from skd_sim.inputs.files import one_line

from skd_evaluator.bags.checks import Damage
from skd_evaluator.report.terminal import counted

_SHOWN = 10


def say_damage(command: str, damage: Damage) -> None:
    """Say on the error stream what was left out, and what is to be known of the rest.

    Args:
        command: name of the command that read the recordings.
        damage: what was found in them.
    """
    say_left_out(command, damage)
    lines = list(damage.warnings)
    if damage.unchecked:
        first = f"{damage.unchecked[0]}" + (", …" if len(damage.unchecked) > 1 else "")
        lines.append(
            f"{counted(len(damage.unchecked), 'file')} without checksums ({first}): damage that leaves a possible "
            "episode cannot be noticed there"
        )
    _warn(command, lines)


def say_left_out(command: str, damage: Damage) -> None:
    """Say on the error stream what was left out, the first of it in full."""
    lines = [f"left out: {line}" for line in damage.left_out[:_SHOWN]]
    if len(damage.left_out) > _SHOWN:
        lines.append(f"left out: {len(damage.left_out) - _SHOWN} more")
    _warn(command, lines)


def _warn(command: str, lines: Sequence[str]) -> None:
    for line in lines:
        print(f"skd {command}: warning: {one_line(line)}", file=sys.stderr)
