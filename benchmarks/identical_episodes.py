"""How many episodes of two assessments are the same to the bit: both ways, the car's speed and the outcome.

    python benchmarks/identical_episodes.py DIR DIR

Episodes are those of one seed, so the folders are to be of the same command, for instance with two middlewares, or in
lockstep and in real time. Those that only one of them has, as where the other one aborted, are left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from skd_sim.episode.episode import Mode

Key = tuple[int, str, int]


def episodes(folder: Path) -> dict[Key, bytes]:
    """Return what identifies an episode against the car, and all that happened in it."""
    with np.load(folder / "episodes.npz") as file:
        columns = {name: file[name] for name in ("mode", "objective", "episode_id", "outcome")}
        offsets, adversary, car = file["offsets"], file["positions"], file["car"]
    found = {}
    for index in range(len(offsets) - 1):
        ticks = slice(offsets[index], offsets[index + 1])
        mode, objective, number, outcome = (column[index] for column in columns.values())
        if mode != Mode.SAFE:
            happened = adversary[ticks].tobytes() + car[ticks].tobytes() + outcome.tobytes()
            found[int(mode), str(objective), int(number)] = happened
    return found


def main() -> None:
    """Count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs=2, type=Path, metavar="DIR")
    first, second = map(episodes, parser.parse_args().folders)
    both = first.keys() & second.keys()
    print(f"{sum(first[key] == second[key] for key in both)} of {len(both)} episodes are identical")


if __name__ == "__main__":
    main()
