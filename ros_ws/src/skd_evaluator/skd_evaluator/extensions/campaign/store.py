"""Episodes on disk, each as soon as it has run: from these a campaign goes on, whatever has ended it.

One SQLite database in WAL mode, one transaction an episode. A process that is killed loses nothing that it has put:
what it wrote is the system's. With `synchronous = NORMAL` a power cut may take the latest episodes, those since the
last checkpoint, and leaves the database whole; they are then run again and are the same. Waiting for the disk after
each episode (`FULL`) would save these few at the price of a write to the disk for every episode.

SQLite does not check what it reads, so every row carries a digest of all that it says. Only the process that holds the
campaign's lock opens the database: it is locked for good then (`locking_mode = EXCLUSIVE`), which WAL also needs where
there is no shared memory, as on network file systems.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import open_regular
from skd_sim.world.episode import Episode, EpisodeLog

from skd_evaluator.errors import AssessmentError
from skd_evaluator.extensions.campaign.episode_record import Specifications, digest, from_bytes, to_bytes

FILE_NAME = "episodes.sqlite"
_FORMAT = 1
_AT_ONCE = 500  # keys in one query
_TABLE = """
CREATE TABLE episodes (
    cell BLOB NOT NULL,
    specification BLOB NOT NULL,
    objective TEXT NOT NULL,
    episode_id INTEGER NOT NULL,
    log BLOB NOT NULL,
    checksum BLOB NOT NULL,
    PRIMARY KEY (cell, specification)
)
"""
_SCHEMA = [" ".join(_TABLE.split()), "None"]  # the table, and the index of its key
"""What SQLite says of a database of ours."""


class StoreError(AssessmentError):
    """The store cannot be used any more; the message says what to do, and ends the whole campaign."""


class EpisodeStore:
    """The database; its methods may be called by any thread."""

    def __init__(self, path: Path) -> None:
        """Open it, or make it.

        Raises:
            UsageError: it is damaged, of another version of SKD, or somebody else has it open.
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
            if tables:
                # A view in the place of the table may never end, and a trigger do anything.
                if [" ".join(str(sql).split()) for (sql,) in ask("SELECT sql FROM sqlite_master")] != _SCHEMA:
                    raise sqlite3.DatabaseError("it holds something else than episodes")
                (verdict,) = ask("PRAGMA quick_check(1)").fetchone()
                if verdict != "ok":
                    raise sqlite3.DatabaseError(" ".join(str(verdict).split()))
            if not tables and not version:
                ask("BEGIN IMMEDIATE")
                ask(_TABLE)
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
                raise StoreError(
                    f"{what}: it cannot be written; see to the disk, and go on with the same command and --resume"
                ) from error
            raise self._damaged(said) from error

    def _damaged(self, why: str) -> StoreError:
        return StoreError(
            f"{self._path}: damaged ({why}); delete it and add --resume: cells that are done stay, episodes of the "
            "others are run again and come out the same"
        )

    def _ask(self, statement: str, values: Sequence[object] = ()) -> list[tuple[bytes, ...]]:
        with self._lock, self._failing():
            if self._connection is None:
                raise StoreError(f"{self._path}: closed")
            return self._connection.execute(statement, values).fetchall()

    def known(self, cell: bytes, specifications: Sequence[bytes]) -> set[bytes]:
        """Return which of some specifications there are episodes of."""
        found: set[bytes] = set()
        for start in range(0, len(specifications), _AT_ONCE):
            some = specifications[start : start + _AT_ONCE]
            marks = ",".join("?" * len(some))
            rows = self._ask(
                f"SELECT specification FROM episodes WHERE cell = ? AND specification IN ({marks})",
                (cell, *some),
            )
            found.update(row[0] for row in rows)
        return found

    def get(self, cell: bytes, specification: bytes, episode: Episode) -> EpisodeLog:
        """Return what happened in an episode that there is.

        Raises:
            StoreError: it is not what was put.
        """
        rows = self._ask(
            "SELECT log, checksum FROM episodes WHERE cell = ? AND specification = ?", (cell, specification)
        )
        try:
            ((data, checksum),) = rows
            if not isinstance(data, bytes) or checksum != digest(cell, specification, data):
                raise ValueError("its checksum is another")
            return from_bytes(data, episode)
        except ValueError as error:
            raise self._damaged(f"episode {episode.episode_id}: {error}") from error

    def put(self, cell: bytes, specification: bytes, log: EpisodeLog) -> None:
        """Keep what happened in an episode; when this returns, the death of this process does not take it."""
        data = to_bytes(log)
        episode = log.episode
        self._ask(
            "INSERT OR REPLACE INTO episodes VALUES (?, ?, ?, ?, ?, ?)",
            (
                cell, specification, str(episode.objective), episode.episode_id, data,
                digest(cell, specification, data),
            ),
        )  # fmt: skip

    def count(self) -> int:
        """Return how many episodes there are."""
        ((number,),) = self._ask("SELECT count(*) FROM episodes")
        return int(number)

    def drop(self, cell: bytes) -> None:
        """Forget the episodes of a cell; their place is used again."""
        self._ask("DELETE FROM episodes WHERE cell = ?", (cell,))

    def keep_only(self, cells: Sequence[bytes]) -> None:
        """Forget the episodes of all other cells."""
        for (cell,) in self._ask("SELECT DISTINCT cell FROM episodes"):
            if cell not in cells:
                self.drop(cell)

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
    """Delete a store of which nothing is wanted, if there is one; nobody has it open."""
    for suffix in ("-wal", "-shm", "-journal", ""):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


class CellStore:
    """The part of the store that belongs to one cell."""

    def __init__(self, store: EpisodeStore, cell: bytes) -> None:
        """Use a store.

        Args:
            store: the store of the whole campaign.
            cell: digest of all that determines an episode beside its specification.
        """
        self._store, self._cell = store, cell
        self._specifications = Specifications()

    def specifications(self, episodes: Sequence[Episode]) -> list[bytes]:
        """Return the digest of each episode's specification."""
        return [self._specifications.digest(one) for one in episodes]

    def known(self, specifications: Sequence[bytes]) -> set[bytes]:
        """Return which of some specifications there are episodes of."""
        return self._store.known(self._cell, specifications)

    def get(self, specification: bytes, episode: Episode) -> EpisodeLog:
        """Return what happened in an episode that there is."""
        return self._store.get(self._cell, specification, episode)

    def put(self, specification: bytes, log: EpisodeLog) -> None:
        """Keep what happened in an episode."""
        self._store.put(self._cell, specification, log)
