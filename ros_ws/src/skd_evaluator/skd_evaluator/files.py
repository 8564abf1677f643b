"""What to call folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skd_sim.inputs.outside import real_path


def tails(folders: Sequence[Path]) -> list[str]:
    """Return of each folder as little of the end of its path as tells all of them apart."""
    parts = [real_path(folder).parts for folder in folders]
    count = 1
    while count < max(map(len, parts), default=0) and len({one[-count:] for one in parts}) < len(set(parts)):
        count += 1
    return [str(Path(*one[-count:])) for one in parts]
