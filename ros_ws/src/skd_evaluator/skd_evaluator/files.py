"""What to call folders, and which results a command has put in their place."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from skd_sim.inputs.outside import real_path


def tails(folders: Sequence[Path]) -> list[str]:
    """Return of each folder as little of the end of its path as tells all of them apart."""
    parts = [real_path(folder).parts for folder in folders]
    count = 1
    while count < max(map(len, parts), default=0) and len({one[-count:] for one in parts}) < len(set(parts)):
        count += 1
    return [str(Path(*one[-count:])) for one in parts]


_in_place: Final[list[Path]] = []


def begin_command() -> None:
    """Forget what a command of before has written: this process may run several."""
    _in_place.clear()


def note_in_place(path: Path) -> None:
    """Note that results are in their place, whole: what comes afterwards takes nothing of them back."""
    _in_place.append(path)


def what_is_in_place() -> str:
    """Return what an interrupted command has written, in a few words."""
    return f"results are in {' and '.join(map(str, _in_place))}" if _in_place else "nothing was written"
