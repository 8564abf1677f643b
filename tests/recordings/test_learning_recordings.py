"""Recordings of a campaign that learned its car: kamikazes of one id try it with several models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from bag_forge import Sent, campaign_messages
from recordings_support import Replayed
from skd_adversary.car_models.car_model_file import car_model_text, fitted_car
from skd_adversary.warm_up import any_car_models
from skd_evaluator.assessment.plan import Plan, Stage, episode_id
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.stages.car_model import own_trials
from skd_evaluator.ros.recording import bag_name
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

CAR = fitted_car(any_car_models()[0])


def _trials(log: EpisodeLog) -> list[EpisodeSpec]:
    """Kamikazes of one id that wait in two ways."""
    plan = Plan(load_scenario("crossing"), multiplier=1.1, simulations=3, seed=2)
    phi = log.episode.safe_trajectory
    assert phi is not None
    models = [car_model_text(replace(CAR, waiting_reward=reward)) for reward in (-0.1, -0.4)]
    return [
        one
        for model in models
        for one in own_trials(plan, model, [phi], 2, begin=100, objectives=(Objective.DEVIATION,))
    ]


def test_each_has_a_bag_of_its_own(logs: list[EpisodeLog]) -> None:
    trials = _trials(logs[0])
    assert trials[0].episode_id == trials[2].episode_id == episode_id(Stage.LEARNING, 0, 100)
    episodes = [*trials, *(log.episode for log in logs)]
    assert len({bag_name(one) for one in episodes}) == len(episodes)


def test_they_are_no_contradiction(
    logs: list[EpisodeLog], replay: Callable[..., Replayed], recorded: Callable[[Sequence[Sequence[Sent]]], Path]
) -> None:
    """And none of them counts: the figures are those of the campaign alone."""
    alone = replay(recorded(campaign_messages(logs)))
    learned = replay(recorded(campaign_messages([*map(run_episode, _trials(logs[0])), *logs])))
    assert (alone.code, learned.code) == (0, 0), learned.err
    assert learned.episodes == alone.episodes
