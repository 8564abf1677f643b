"""How often a stack is not believed that draws, in each later graph, whether it is careful: by drawn collisions.

`.venv/bin/python benchmarks/three_runs.py`. In its first graph the stack is careful in all crossings of the risk, so
that it collides in none, and in no run along φ. Else somebody who crosses is hit with the probability `HIT`. In each of
the two graphs in which its episodes are run again it is careful in some of them, drawn one by one.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from skd_evaluator.assessing.otherwise import first_run_flatters
from skd_evaluator.campaign.plan.plan import Stage, episode_id
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory

HIT = 0.7
SHARES = ((0.5, 0.7), (0.7, 0.7), (0.9, 0.9))
"""Of the episodes in which it is careful, in the second and in the third graph."""
COUNTS = (24, 60)
"""Episodes of each of the two figures."""
_STAGES = (Stage.RISK, Stage.COLLISION_RATE)


def drawn_runs(shares: tuple[float, float], count: int, rng: np.random.Generator) -> list[list[EpisodeLog]]:
    """Return three runs of `count` episodes of each figure, of which the outcome alone is drawn."""
    scenario = load_scenario("crossing")
    states = np.zeros((2, 3))
    phi = Trajectory(states[:, :2], scenario.time_step, "")

    def logs(stage: Stage, careful: float) -> Iterator[EpisodeLog]:
        for number, hit in enumerate(rng.random(count) < HIT * (1.0 - careful)):
            episode = Episode(scenario, Mode.REPLAY, 0, episode_id(stage, 0, number), safe_trajectory=phi)
            outcome = Outcome.COLLISION if hit else Outcome.ARRIVED
            yield EpisodeLog(episode, outcome, states[:, :2], states, np.nan, np.nan)

    first = [log for stage in _STAGES for log in logs(stage, float(stage == Stage.RISK))]
    return [first, *([log for stage in _STAGES for log in logs(stage, share)] for share in shares)]


def main() -> None:
    """Print the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=1000, metavar="N", help="assessments of each kind (default 1000)")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    print("careful in the second and third graph, episodes a figure: not believed")
    for shares in SHARES:
        for count in COUNTS:
            found = sum(bool(first_run_flatters(drawn_runs(shares, count, rng))) for _ in range(arguments.draws))
            print(f"{shares[0]:.0%} and {shares[1]:.0%}, {count}: {found / arguments.draws:.0%}")


if __name__ == "__main__":
    main()
