"""How long kamikazes wait for a learned car is what they come to with it, tried against the car."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pytest
from skd_adversary.adversary import any_car_models, predicted_car
from skd_adversary.car_models.car_model_file import FittedCar, car_model_text, fitted_car
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.stages.car_model import CHOICES, WAITING_TRIALS, with_waiting_reward
from skd_evaluator.errors import AssessmentError
from skd_sim.options.adversary import AdversaryModel
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

CROSSING = load_scenario("crossing")
STANDS = Trajectory(np.zeros((4, 2)), CROSSING.time_step)
LAW, FOREST = (fitted_car(text) for text in any_car_models())
PLAN = Plan(CROSSING, controller="cars:Any", adversary_model=AdversaryModel.LEARNED)
USUAL, OTHERS = CHOICES[0], CHOICES[1:]


class Played:
    """Has kamikazes stray so far, in m, by how they wait: who strays nowhere does not hit."""

    def __init__(self, strayed: Mapping[float, Sequence[float]]) -> None:
        self.strayed, self.asked = strayed, list[tuple[float, list[EpisodeSpec]]]()

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        reward = fitted_car(episodes[0].car_model).waiting_reward
        self.asked.append((reward, list(episodes)))
        for number, one in enumerate(episodes):
            far = self.strayed[reward][number % len(self.strayed[reward])]
            there = np.array([(0.0, 0.0), (far, 0.0)])
            if far > 0.0:
                step = CROSSING.time_step
                yield EpisodeLog(one, Outcome.COLLISION, there, np.zeros((2, 4)), step, 3.0)
            else:
                yield EpisodeLog(one, Outcome.ABORTED if math.isnan(far) else Outcome.MISSED, there, np.zeros((2, 4)))


def chosen(strayed: Mapping[float, Sequence[float]], car: FittedCar = FOREST) -> tuple[float | None, Played]:
    runner = Played(strayed)
    return with_waiting_reward(PLAN, car, [STANDS], runner, lambda *_told: None)[0].waiting_reward, runner


@pytest.mark.parametrize("best", CHOICES)
def test_the_least_mean_deviation_is_chosen_and_a_miss_counts_as_the_greatest(best: float) -> None:
    """A miss in ten counts 0.1 · η_max = 0.5 m; that and 0.9 · 1 m are more than 1.3 m in all trials."""
    reward, runner = chosen({one: [1.3] if one == best else [1.0] * 9 + [0.0] for one in CHOICES})
    if best == USUAL:  # all hit: what the others do is not asked
        assert [one for one, _ in runner.asked] == [USUAL]
    else:
        assert [one for one, _ in runner.asked] == list(CHOICES)
    assert reward == best


def test_trials_that_are_aborted_do_not_count_unless_all_are() -> None:
    reward, _ = chosen({USUAL: [0.0, math.nan], **{one: [1.0, math.nan] for one in OTHERS}})
    assert reward == OTHERS[0]
    with pytest.raises(AssessmentError, match=f"all {WAITING_TRIALS} waiting trials were aborted"):
        chosen({one: [math.nan] for one in CHOICES})


@pytest.mark.parametrize("car", [LAW, FOREST])
def test_kamikazes_plan_with_it(car: FittedCar) -> None:
    said = dataclasses.replace(car, waiting_reward=-0.3)
    episode = EpisodeSpec(
        CROSSING, Mode.KAMIKAZE, 0, 0, STANDS, adversary_model=AdversaryModel.LEARNED, car_model=car_model_text(said)
    )
    assert predicted_car(episode).parameters(CROSSING)["waiting_reward"] == -0.3
    silent = dataclasses.replace(episode, car_model=car_model_text(car))
    assert predicted_car(silent).parameters(CROSSING)["waiting_reward"] in CHOICES[:2]
