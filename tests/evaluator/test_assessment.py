"""Several objectives over the same φ: what is shared, what is at the top, and what is on disk."""

from dataclasses import replace

import numpy as np
import pytest
from skd_evaluator.assessment.episode_figures import command_age, missed_periods, standing_contacts
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, split_episode_id
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, load_scenario
from skd_sim.options.car_and_adversary import Objective
from skd_sim.world.episode import Timing
from stages import rate
from test_campaign import StubRunner, straight
from test_warnings import shown

CROSSING = load_scenario("crossing")
PLAN = Plan(CROSSING, safe_count=2, kamikaze_count=4, collision_runs=6, seed=5, simulations=2)
PAPER, DEVIATION = Objective.PAPER, Objective.DEVIATION


def test_a_maximum_is_one_of_the_distance_that_is_planned_for() -> None:
    """The stub's ψ is one of deviation 1.8 m and of another Fréchet distance."""
    runner = StubRunner(lambda _episode: Outcome.COLLISION)
    free = rate(PLAN, (DEVIATION, PAPER), [straight()], runner)
    needed = free.for_deviation.of_successes.values.max()
    distance = free.for_skd.skd.distances.values.max()
    assert needed < distance
    between = 0.5 * (needed + distance)
    found = rate(replace(PLAN, maximum_distance=between), (DEVIATION, PAPER), [straight()], runner)
    figures = found.as_dict()["objectives"]
    assert figures["deviation"]["discarded_by_distance"] == 0
    assert figures["paper"]["discarded_by_distance"] == 4
    # What a trial needed does not depend on what is kept.
    assert figures["paper"]["deviation"] == free.as_dict()["objectives"]["paper"]["deviation"]


def impacts(*speeds: float) -> list[EpisodeLog]:
    episode = EpisodeSpec(CROSSING, Mode.REPLAY, 0, 0, safe_trajectory=straight())
    return [EpisodeLog(episode, Outcome.COLLISION, np.zeros((2, 2)), np.zeros((2, 4)), 0.2, speed) for speed in speeds]


def test_who_walks_into_a_standing_car_is_counted_apart() -> None:
    assert standing_contacts(impacts(0.0, 0.0999, 0.1, 5.0)) == 2
    missed = [replace(log, outcome=Outcome.MISSED) for log in impacts(0.0)]
    assert standing_contacts(missed) == 0

    class Standing(StubRunner):
        def run(self, episodes):
            for log in super().run(episodes):
                stage, _, number = split_episode_id(log.episode.episode_id)
                slow = number < (1 if stage == EpisodeGroup.KAMIKAZE else 2)
                yield replace(log, impact_speed=0.05) if slow else log

    found = rate(PLAN, (DEVIATION, PAPER), [straight()], Standing(lambda _episode: Outcome.COLLISION))
    result = found.as_dict()
    assert [figures["standing_contacts"] for figures in result["objectives"].values()] == [1, 1]
    assert result["collision_standing_contacts"] == 2
    lines = [line for line in shown(found).splitlines() if "walked into a standing car" in line]
    assert [line.split(" walked into")[0].split()[-1] for line in lines] == ["2", "1", "1"]


def log(timing: Timing, outcome: Outcome = Outcome.ARRIVED) -> EpisodeLog:
    episode = EpisodeSpec(CROSSING, Mode.SAFE, 0, 0)
    return EpisodeLog(episode, outcome, np.zeros((1, 2)), np.zeros((1, 4)), timing=timing)


def test_figures_are_of_all_control_periods_that_count() -> None:
    rng = np.random.default_rng(1)
    ages = rng.gamma(2.0, 0.01, size=1000)
    logs = [log(Timing(tuple(part), held, held / 100)) for held, part in enumerate(np.split(ages, [10, 400, 700]))]
    logs += [log(Timing((9.0,) * 500, 99, 9.0), Outcome.ABORTED), log(Timing())]
    figures = command_age(logs)
    assert figures == {
        "median": pytest.approx(np.sort(ages)[499:501].mean()),
        "p99": pytest.approx(np.quantile(ages, 0.99)),
        "worst": ages.max(),
        "control_periods": 1000,
        "held": 0 + 1 + 2 + 3,
        "greatest_delay": 0.03,
    }
    assert command_age([log(Timing())]) is None


@pytest.mark.parametrize(("held", "said"), [(5, ""), (6, "in 6 of 100"), (25, "in 25"), (26, "not credible: in 26")])
def test_a_stack_that_misses_its_periods_is_not_passed_over(held: int, said: str) -> None:
    """More than 5 % are warned of, more than 25 % are a failure."""
    logs = [log(Timing((0.01,) * 50, held - held // 3)), log(Timing((0.01,) * 50, held // 3)), log(Timing())]
    lines = missed_periods("external", logs)
    assert bool(lines) == bool(said)
    assert all(line.startswith(said) for line in lines)
