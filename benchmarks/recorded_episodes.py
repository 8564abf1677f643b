"""Episodes of a benchmark that have been run, a line of JSON each, so that a long run may be stopped and gone on with.

A line says what was run (problem, planner, simulations, options, seed) and what came of it. It does not say by which
version of the code: a file is of one version, and another one begins another file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Episode:
    """What one episode gave: discounted return, moves, simulations and seconds of planning."""

    value: float
    moves: int
    simulations: int
    seconds: float


class Record:
    """Episodes by what was run and by seed; kept in a file, or, without one, for as long as the object lives."""

    def __init__(self, path: Path | None) -> None:
        """Read what there is; a last line that was cut off is none, and is cut off for good."""
        self._path = path
        self._episodes: dict[str, Episode] = {}
        if path is None or not path.exists():
            return
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            os.truncate(path, len(whole))
        for line in whole.decode().splitlines():
            row = json.loads(line)
            self._episodes[_key(row["run"], row["seed"])] = Episode(**row["episode"])

    def episodes(
        self, run: dict[str, Any], seeds: Iterable[int], pool: Executor, one: Callable[[int], Episode]
    ) -> Iterator[Episode]:
        """Yield the episodes of these seeds, in their order; those that are missing are run first, and added."""
        seeds = list(seeds)
        jobs = {pool.submit(one, seed): seed for seed in seeds if _key(run, seed) not in self._episodes}
        for job in as_completed(jobs):
            self._add(run, jobs[job], job.result())
        for seed in seeds:
            yield self._episodes[_key(run, seed)]

    def _add(self, run: dict[str, Any], seed: int, episode: Episode) -> None:
        self._episodes[_key(run, seed)] = episode
        if self._path is not None:
            with self._path.open("a") as file:
                file.write(json.dumps({"run": run, "seed": seed, "episode": asdict(episode)}) + "\n")


def _key(run: dict[str, Any], seed: int) -> str:
    return json.dumps([run, seed], sort_keys=True)
