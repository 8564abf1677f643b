"""Margins of basic cars that were found before, in the user's cache: one small JSON file for a car and its trials.

A file is named for all that its numbers depend on, written under another name and then renamed, and used only if its
checksum, its shape and the range of its numbers are right; otherwise the margins are computed anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import Trajectory

DEFINITION = 2
"""Of the margin of a trial: one more whenever what `exact_margin` gives for the same episode changes."""
VARIABLE = "SKD_CACHE_DIR"
_FOLDER = "margins"


def margins_key(scenario: Scenario, safe: Sequence[Trajectory], seed: int, trials: int, multiplier: float) -> str:
    """Return the SHA-256 of all that the margins of a basic car depend on, in hexadecimal digits.

    Args:
        scenario: the scenario in which the basic car drives.
        safe: Φ, in the order of their numbers.
        seed: seed of the campaign.
        trials: how many trials there are on each φ.
        multiplier: C of the basic car.
    """
    described = {name: value for name, value in scenario.as_dict().items() if name not in ("name", "description")}
    about = {
        "definition": DEFINITION,
        "scenario": described,
        "safe": [
            [
                list(one.positions.shape),
                one.time_step,
                hashlib.sha256(one.positions.astype("<f8").tobytes()).hexdigest(),
            ]
            for one in safe
        ],
        "seed": seed,
        "trials": trials,
        "multiplier": multiplier,
    }
    return _digest(about)


class MarginCache:
    """A folder of margins."""

    def __init__(self, folder: Path | None) -> None:
        """Keep margins in a folder, or with None nowhere."""
        self._folder = folder

    def load(self, key: str, safe_count: int, trials: int, eta_max: float) -> list[FloatArray] | None:
        """Return the margins kept under a key, m, per φ; None where there are none that can be believed."""
        if self._folder is None:
            return None
        try:
            path = self._path(key)
            content = read_json(path)
            margins = content["margins"]
            if content["key"] != key or content["checksum"] != _digest(margins):
                return None
            found = np.array(margins, dtype=np.float64)  # null is nan
        except (UsageError, OSError, ValueError, KeyError, TypeError):
            return None
        fits = found.shape == (safe_count, trials) and bool(
            ((found >= 0.0) & (found <= eta_max) | np.isnan(found)).all()
        )
        return list(found) if fits else None

    def save(self, key: str, margins: Sequence[FloatArray]) -> None:
        """Keep margins, m, per φ; where that is not possible, they will be computed again."""
        if self._folder is None:
            return
        rows = [[None if np.isnan(value) else value for value in one.tolist()] for one in margins]
        text = json.dumps({"key": key, "checksum": _digest(rows), "margins": rows})
        with contextlib.suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            descriptor, name = tempfile.mkstemp(dir=self._folder, prefix=f".{key[:16]}-")
            try:
                with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
                    stream.write(text)
                Path(name).replace(self._path(key))
            except OSError:
                Path(name).unlink(missing_ok=True)
                raise

    def _path(self, key: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{key}.json"


def users_cache() -> MarginCache:
    """Return the cache in $SKD_CACHE_DIR, else in the user's; one that keeps nothing where others may write to it."""
    try:
        root = os.environ.get(VARIABLE)
        base = Path(root) if root else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skd"
        folder = base / _FOLDER
        base.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        found = folder.lstat()
    except (OSError, RuntimeError):  # the latter where nobody knows a home
        return MarginCache(None)
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o022
    return MarginCache(folder if ours else None)


def _digest(content: Mapping[str, Any] | list[Any]) -> str:
    """Return the SHA-256 of plain data; floats are written so that they are read back to the last bit."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()
