"""The ages of commands over a campaign: percentiles of all control periods, of episodes that count."""

from __future__ import annotations

import numpy as np
import pytest
from skd_evaluator.assessment.episode_figures import command_age, missed_periods
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.timing import Timing

EPISODE = EpisodeSpec(load_scenario("crossing"), Mode.SAFE, 0, 0)
NOTHING = np.zeros((1, 2)), np.zeros((1, 4))


def log(timing: Timing, outcome: Outcome = Outcome.ARRIVED) -> EpisodeLog:
    return EpisodeLog(EPISODE, outcome, *NOTHING, timing=timing)


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
