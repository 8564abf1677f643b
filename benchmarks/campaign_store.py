"""What it costs to store an episode of a campaign: bytes on the disk, time of one core to write and to read it."""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaigns.store import FILE_NAME, CellStore, EpisodeStore
from skd_evaluator.cli.arguments import whole_number
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory

TICKS = (10, 20)


def measure(count: int, ticks: int, folder: Path) -> tuple[float, float, float]:
    """Return bytes an episode, and seconds of a core to write and to read it."""
    scenario = load_scenario("crossing")
    phi = Trajectory(np.array([(-2.0, 0.0), (2.0, 0.0)]), scenario.time_step)
    draws = np.random.default_rng(0)
    logs = [
        EpisodeLog(
            Plan(scenario).episode(Mode.KAMIKAZE, 0, number, phi),
            Outcome.COLLISION,
            draws.normal(size=(ticks, 2)),
            draws.normal(size=(ticks, 3)),
            belief=draws.normal(size=(ticks, 4)),
        )
        for number in range(count)
    ]
    whole = EpisodeStore(folder / FILE_NAME)
    store = CellStore(whole, b"")
    begin = time.process_time()
    keys = store.specifications([log.episode for log in logs])
    for key, log in zip(keys, logs, strict=True):
        store.put(key, log)
    written = time.process_time()
    store.known(keys)
    for key, log in zip(keys, logs, strict=True):
        store.get(key, log.episode)
    read = time.process_time()
    whole.close()
    return (folder / FILE_NAME).stat().st_size / count, (written - begin) / count, (read - written) / count


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=whole_number(1), default=20_000, metavar="N")
    arguments = parser.parse_args()
    for ticks in TICKS:
        with tempfile.TemporaryDirectory() as folder:
            size, to_write, to_read = measure(arguments.episodes, ticks, Path(folder))
        print(f"{ticks} ticks: {size:.0f} bytes, {1e3 * to_write:.3f} ms to write, {1e3 * to_read:.3f} ms to read")


if __name__ == "__main__":
    main()
