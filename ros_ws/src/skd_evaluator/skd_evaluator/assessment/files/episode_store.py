"""Episodes on disk, each as soon as it has run: from these a campaign goes on, whatever has ended it.

One SQLite database in WAL mode, one transaction an episode. A process that is killed loses nothing that it has put:
what it wrote is the system's. With `synchronous = NORMAL` a power cut may take the latest episodes, those since the
last checkpoint, and leaves the database whole; they are then run again and are the same.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.inputs.files import open_regular
from skd_sim.options.options import options_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome, Timing
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.context import Runner

DIGEST_BYTES = 16


def flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested mappings as one, with the keys in between joined by dots."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return found


def changes(then: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return what differs in plain data, by its keys joined by dots: value then and now; None of what is not there."""
    before, after = (flat(json.loads(json.dumps(one))) for one in (then, now))
    pairs = {key: (before.get(key), after.get(key)) for key in {**after, **before}}
    return {key: (one, other) for key, (one, other) in pairs.items() if one != other}


def digest(*parts: bytes) -> bytes:
    """Return 16 bytes that no other parts have; each part is told from its neighbours."""
    found = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for part in parts:
        found.update(len(part).to_bytes(8, "little"))
        found.update(part)
    return found.digest()


def digest_of(content: Any) -> bytes:
    """Return the digest of plain data, whatever the order of its keys."""
    return digest(json.dumps(content, sort_keys=True, ensure_ascii=True).encode())


def digest_of_specification(episode: EpisodeSpec) -> bytes:
    """Return a digest of all that an episode's specification says."""
    phi = episode.safe_trajectory
    plain = [one.plain(getattr(episode, one.name)) for one in options_of(EpisodeSpec)]
    plain += [int(episode.mode), episode.seed, episode.episode_id]
    parts = [_digest_of_part(episode.scenario), b"" if phi is None else _digest_of_part(phi), repr(plain).encode()]
    if episode.public is not None:  # few have another one than their own
        parts.append(_digest_of_part(episode.public))
    return digest(*parts)


@functools.lru_cache(maxsize=4096)
def _digest_of_part(part: Scenario | Trajectory) -> bytes:
    """Return the digest of what episodes of one assessment share."""
    return digest_of(part.as_dict()) if isinstance(part, Scenario) else digest_of_trajectory(part)


def digest_of_trajectory(one: Trajectory) -> bytes:
    """Return a digest of a trajectory's positions, shape, time step and name."""
    positions = np.ascontiguousarray(one.positions, "<f8")
    return digest(positions.tobytes(), repr((positions.shape, float(one.time_step), one.name)).encode())


_TABLES = ("adversary", "car", "belief", "commands")
_PLAIN = tuple(one.name for one in fields(EpisodeLog) if one.name not in ("episode", *_TABLES))


def to_bytes(log: EpisodeLog) -> bytes:
    """Return what happened in an episode; its specification is not part of it."""
    tables = {name: table for name in _TABLES if (table := getattr(log, name)) is not None}
    shapes = {name: table.shape for name, table in tables.items()}
    head = json.dumps([shapes, {name: getattr(log, name) for name in _PLAIN}]).encode()
    numbers = [np.asarray(table, "<f8").tobytes() for table in tables.values()]
    return b"".join((len(head).to_bytes(4, "little"), head, *numbers))


def from_bytes(data: bytes, episode: EpisodeSpec) -> EpisodeLog:
    """Return the log of an episode; the inverse of `to_bytes`."""
    begin = 4 + int.from_bytes(data[:4], "little")
    shapes, found = json.loads(data[4:begin])
    numbers = np.frombuffer(data, "<f8", offset=begin).astype(np.float64)
    parts = np.split(numbers, np.cumsum([math.prod(shape) for shape in shapes.values()])[:-1])
    found |= {name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)}
    ages, held, delay = found["timing"]
    return EpisodeLog(
        episode, **found | {"outcome": Outcome(found["outcome"]), "timing": Timing(tuple(ages), held, delay)}
    )


FILE_NAME = "episodes.sqlite"
_FORMAT = 7
_TABLE = """
CREATE TABLE episodes (
    cell BLOB NOT NULL,
    specification BLOB NOT NULL,
    log BLOB NOT NULL,
    PRIMARY KEY (cell, specification)
)
"""
_ABOUT = "CREATE TABLE about (content TEXT NOT NULL)"


class StoreError(AssessmentError):
    """The store cannot be used any more; the message says what to do, and ends the whole campaign."""


class EpisodeStore:
    """The database; its methods may be called by any thread."""

    def __init__(self, path: Path) -> None:
        """Open it, or make it.

        Raises:
            UsageError: it is damaged, of another version of SKD, or another process has it open.
            StoreError: it cannot be written.
        """
        self._path = path
        self._lock = threading.Lock()
        self._connection: sqlite3.Connection | None = None
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        if self._path.exists():
            open_regular(self._path).close()  # of a pipe SQLite waits for what never comes
        with self._failing():
            # Autocommit: a statement is a transaction, and is there as soon as it has returned.
            self._connection = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False, timeout=0.0)
            ask = self._connection.execute
            for setting in ("locking_mode = EXCLUSIVE", "journal_mode = WAL", "synchronous = NORMAL"):
                ask(f"PRAGMA {setting}")
            (version,) = ask("PRAGMA user_version").fetchone()
            (tables,) = ask("SELECT count(*) FROM sqlite_master").fetchone()
            if not tables and not version:
                ask("BEGIN IMMEDIATE")
                ask(_TABLE)
                ask(_ABOUT)
                ask(f"PRAGMA user_version = {_FORMAT}")
                ask("COMMIT")
            elif version != _FORMAT:
                raise UsageError(f"{self._path}: of another version of SKD (format {version}); give another --out")

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """Say in one line what is wrong with the database."""
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter of a message that quotes what is no text
            said = " ".join(str(error).split())  # which may quote what the file holds
            what = f"{self._path}: {said}"
            code = getattr(error, "sqlite_errorname", "")
            if code.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
                raise UsageError(f"{what}: another process has it open") from error
            if code.startswith(("SQLITE_FULL", "SQLITE_IOERR", "SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM")):
                raise StoreError(f"{what}: it cannot be written; see to the disk, and go on with --resume") from error
            how = "delete it and start the same command again: its episodes come out the same"
            raise StoreError(f"{self._path}: damaged ({said}); {how}") from error

    def _ask(self, statement: str, values: Sequence[object] = ()) -> list[tuple[bytes, ...]]:
        with self._lock, self._failing():
            if self._connection is None:
                raise StoreError(f"{self._path}: closed")
            return self._connection.execute(statement, values).fetchall()

    def known(self, cell: bytes, specifications: Sequence[bytes]) -> set[bytes]:
        """Return which of some specifications there are episodes of."""
        rows = self._ask("SELECT specification FROM episodes WHERE cell = ?", (cell,))
        return {row[0] for row in rows}.intersection(specifications)

    def get(self, cell: bytes, specification: bytes, episode: EpisodeSpec) -> EpisodeLog:
        """Return what happened in an episode that there is."""
        rows = self._ask("SELECT log FROM episodes WHERE cell = ? AND specification = ?", (cell, specification))
        return from_bytes(rows[0][0], episode)

    def put(self, cell: bytes, specification: bytes, log: EpisodeLog) -> None:
        """Keep what happened in an episode; when this returns, the death of this process does not take it."""
        self._ask("INSERT OR REPLACE INTO episodes VALUES (?, ?, ?)", (cell, specification, to_bytes(log)))

    def about(self) -> dict[str, Any]:
        """Return what was written of all episodes; empty where nothing was."""
        rows = self._ask("SELECT content FROM about")
        return dict(json.loads(rows[-1][0])) if rows else {}

    def write_about(self, content: Mapping[str, Any]) -> None:
        """Keep, as JSON, what holds of all episodes."""
        self._ask("INSERT INTO about VALUES (?)", (json.dumps(content),))

    def count(self) -> int:
        """Return how many episodes there are."""
        ((number,),) = self._ask("SELECT count(*) FROM episodes")
        return int(number)

    def drop(self, cell: bytes) -> None:
        """Forget the episodes of a cell; their place is used again."""
        self._ask("DELETE FROM episodes WHERE cell = ?", (cell,))

    def keep_only(self, cells: Sequence[bytes]) -> None:
        """Forget the episodes of all other cells."""
        self._ask(f"DELETE FROM episodes WHERE cell NOT IN ({','.join('?' * len(cells))})", cells)

    def close(self) -> None:
        """Let go of it."""
        with self._lock:
            if self._connection is not None:
                with suppress(sqlite3.Error):
                    self._connection.close()
                self._connection = None

    def remove(self) -> None:
        """Delete it, once nothing in it is wanted any more."""
        self.close()
        remove_files(self._path)


def remove_files(path: Path) -> None:
    """Delete a store of which nothing is wanted, if there is one; it is not open."""
    for suffix in ("-wal", "-shm", "-journal", ""):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


class StoppedError(RuntimeError):
    """The campaign is to end; no episode is worth waiting for any more."""


class StoringRunner:
    """Runs episodes, or reads what became of them; an `Runner`.

    A plan draws its episodes deterministically, so the same plan over the same store goes on where it was. An aborted
    episode is passed on and not stored: it says something about the machine only, so it is run again when the campaign
    is resumed.

    Attributes:
        given: how many episodes there have been so far.
        read: how many of them had been stored before.
    """

    def __init__(self, runner: Runner, store: EpisodeStore, cell: bytes, stop: threading.Event) -> None:
        """Let `runner` do what is missing in a store, until `stop` is set.

        Args:
            runner: runs episodes.
            store: the store of the whole campaign.
            cell: digest of all that determines an episode beside its specification.
            stop: set when the campaign is to end.
        """
        self._runner, self._store, self._cell, self._stop = runner, store, cell, stop
        self.given = self.read = 0

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        """Run all of `episodes`; see `Runner`.

        Raises:
            StoppedError: the campaign is to end.
            StoreError: the store is damaged, or cannot be written.
        """
        keys = [digest_of_specification(one) for one in episodes]
        known = self._store.known(self._cell, keys)
        pairs = list(zip(keys, episodes, strict=True))
        missing = [episode for key, episode in pairs if key not in known]
        fresh = self._runner.run(missing) if missing else iter(())
        for key, episode in pairs:
            if self._stop.is_set():
                raise StoppedError
            if key in known:
                log = self._store.get(self._cell, key, episode)
                self.read += 1
            else:
                log = next(fresh)
                if log.outcome != Outcome.ABORTED:
                    self._store.put(self._cell, key, log)
            self.given += 1
            yield log
