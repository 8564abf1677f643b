"""What the graph is told of an assessment is what assessment.json says."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from skd_evaluator import Assessment, Plan
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import EquivalentMultiplier, Margins
from skd_evaluator.ros.evaluator import assessment_to_message
from skd_sim import EpisodeLog, Mode, Outcome, Trajectory, load_scenario
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, Objective
from stages import rate

OF_THE_CAMPAIGN = {"header", "campaign", "scenario_name"}
IN_WORDS = {"equivalent_multiplier", "equivalent_multiplier_ci95", "margin_converged"}
"""What JSON has as null, for it knows no infinity; or what is false where it is null."""


def rated(outcome: Outcome) -> Assessment:
    """Of episodes that all end so; those of different objectives at different places and speeds."""

    class Runner:
        def run(self, episodes):
            for episode in episodes:
                aside = 1.0 + (episode.objective == Objective.PAPER) + 0.1 * (episode.episode_id % 3)
                walked = np.array(episode.start) + np.array([[0.0, 0.0], [0.5, 0.0], [1.0, aside]])
                still = episode.mode == Mode.REPLAY and episode.episode_id % 2 == 1
                hit = (0.5, 0.0 if still else 4.0) if outcome == Outcome.COLLISION else ()
                yield EpisodeLog(episode, outcome, walked, np.zeros((3, 4)), *hit)

    x = np.arange(-3.5, 3.0, 0.75)
    safe = [Trajectory(np.column_stack([x, np.full_like(x, y)]), 0.3, f"{y}") for y in (0.0, 1.0)]
    plan = Plan(load_scenario("crossing"), safe_count=2, kamikaze_count=5, collision_runs=8, seed=7)
    return rate(plan, DEFAULT_OBJECTIVES, safe, Runner())


@pytest.mark.parametrize("outcome", [Outcome.COLLISION, Outcome.MISSED])
def test_every_field_is_the_figure_of_that_name(outcome: Outcome) -> None:
    found = rated(outcome)
    result = found.as_dict()
    message = assessment_to_message(found, "night", 1_500_000_000)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    assert (message.campaign, message.scenario_name) == ("night", "crossing")
    for name in set(message.get_fields_and_field_types()) - OF_THE_CAMPAIGN - IN_WORDS:
        said, figure = getattr(message, name), result[name]
        if name.endswith(("_ci95", "_trials", "_pairs", "_runs")):
            np.testing.assert_array_equal(said, [math.nan] * 2 if figure is None else figure, err_msg=name)
        elif figure is None:
            assert math.isnan(said), name
        else:
            assert said == figure, name
    if outcome == Outcome.COLLISION:
        assert message.deviation < message.eta_max == 5.0
        assert (message.collision_runs, message.collision_standing_contacts) == (8, 4)
    else:
        assert (message.deviation, message.deviation_success_rate) == (5.0, 0.0)
        assert math.isnan(message.skd)


def test_the_margin_is_told_and_what_lies_beyond_is_infinite() -> None:
    found = rated(Outcome.COLLISION)
    nothing = assessment_to_message(found, "night", 0)
    assert math.isnan(nothing.margin)
    assert not nothing.margin_converged
    assert math.isnan(nothing.optimality_gap)
    ways = tuple(tuple(Hit(0.1 * (k + 1), phi, len(phi) - 1.0, 4.0, 0.0) for k in range(5)) for phi in found.safe)
    equivalent = EquivalentMultiplier(math.inf, (1.25, math.inf), (1.25, math.inf), 0.5, 1.5)
    rating = dataclasses.replace(found, margins=Margins(ways, 5.0), equivalent=equivalent)
    message, result = assessment_to_message(rating, "night", 0), rating.as_dict()
    assert message.margin == pytest.approx(0.3)
    assert list(message.margin_ci95) == pytest.approx(list(result["margin_ci95"]))
    assert message.margin_converged
    assert message.optimality_gap == pytest.approx(result["optimality_gap"])
    assert result["equivalent_multiplier"] is None
    assert message.equivalent_multiplier == math.inf
    assert list(message.equivalent_multiplier_ci95) == [1.25, math.inf]
    # Half of the runs along φ only walk into the standing car.
    assert (message.nominal_collision_rate, message.contact_rate) == (0.5, 1.0)


def test_figures_that_are_not_credible_are_not_told_to_who_sees_no_warning() -> None:
    found = replace(rated(Outcome.COLLISION), warnings=("something else",))
    assert assessment_to_message(found, "", 0).deviation > 0.0
    message = assessment_to_message(replace(found, warnings=(f"{NOT_CREDIBLE}it stands",)), "", 0)
    for name, kind in message.get_fields_and_field_types().items():
        if kind.startswith("double") and name not in {"multiplier", "eta_max"}:
            assert np.isnan(getattr(message, name)).all(), name
    trials = found.as_dict()["kamikaze_trials"]
    assert (message.multiplier, message.eta_max, message.kamikaze_trials) == (1.0, 5.0, trials)
    assert not message.margin_converged
