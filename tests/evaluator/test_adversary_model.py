"""What the adversary knows of the car: said once, never mixed; and a car that is learned before it is rated."""

import datetime
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skd_adversary.adversary import any_car_models, make_adversary, predicted_car
from skd_adversary.car_models.car_model_file import FittedCar, car_model_text, fitted_car
from skd_adversary.crossing.cars import known_basic_car, unknown_car
from skd_evaluator import AssessmentError, Plan
from skd_evaluator.assessment.from_options import plan_of
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages import car_model as learning
from skd_evaluator.assessment.stages.car_model import CHOICES, kept_models, learned, model_file, needs_learning
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import AdversaryModel
from skd_sim.options.options import EpisodeOptions, options_of
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, Trajectory

CROSSING = load_scenario("crossing")
PHI = Trajectory(np.array([(-3.0, 0.0), (0.0, 0.0), (3.0, 0.0)]), CROSSING.time_step)


class Creeps:
    """A car that drives slowly near anybody."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        pass

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return (2.0 if abs(adversary.y - car.y) < 15.0 else 8.0) - car.speed


OWN = f"{Path(__file__).stem}:Creeps"


def values(**said: object) -> dict[str, object]:
    """Return what a command line has where only this is said."""
    return {one.name: one.plain_default for one in options_of(EpisodeOptions)} | {"objective": "paper"} | said


@pytest.mark.parametrize(
    ("said", "adversary_model"),
    [
        ({}, "exact"),
        ({"controller": "cal"}, "generic"),
        ({"controller": "external"}, "generic"),
        ({"controller": OWN, "adversary_model": "generic"}, "generic"),
        ({"adversary_model": "generic"}, "generic"),
        ({"adversary_model": "learned"}, "learned"),
    ],
)
def test_what_is_asked_for(said: dict[str, object], adversary_model: str) -> None:
    plan = plan_of(values(**said), CROSSING)
    assert plan.adversary_model == plan.resolved_adversary_model == AdversaryModel(adversary_model)
    assert plan.episode(Mode.REPLAY, 0, 0, PHI).adversary_model == AdversaryModel(adversary_model)
    assert needs_learning(plan) == (adversary_model == "learned")


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"controller": "cal", "adversary_model": "exact"}, "how car cal decides is not known"),
        ({"car_model": "m.yaml", "adversary_model": "generic"}, "leave out the car model, or generic"),
    ],
)
def test_what_does_not_go_together(said: dict[str, object], words: str) -> None:
    with pytest.raises(UsageError, match=words) as caught:
        plan_of(values(**said), CROSSING)
    assert "\n" not in str(caught.value)


def test_who_plans_with_what() -> None:
    basic = EpisodeSpec(CROSSING, Mode.KAMIKAZE, 0, 0, PHI)
    assert predicted_car(basic) == known_basic_car(1.0)
    assert predicted_car(replace(basic, adversary_model=AdversaryModel.GENERIC)) == unknown_car()
    for model, kernels in zip(any_car_models(), ("fitted", "forest"), strict=True):
        learned_of = replace(basic, adversary_model=AdversaryModel.LEARNED, car_model=model)
        assert predicted_car(learned_of).kernels.name == kernels
    with pytest.raises(UsageError, match="the episode carries none"):
        make_adversary(replace(basic, adversary_model=AdversaryModel.LEARNED))


@pytest.fixture
def small_lessons(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(learning, "PROBES", 12)
    monkeypatch.setattr(learning, "TRIALS", 4)
    monkeypatch.setattr(learning, "WAITING_TRIALS", 2)
    monkeypatch.setattr(learning, "SAFE", 2)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def test_a_car_is_learned_once_and_the_same_by_any_number_of_workers(small_lessons: None) -> None:
    plan = Plan(CROSSING, controller=OWN, adversary_model=AdversaryModel.LEARNED, seed=5)
    said: list[str] = []
    with InProcessRunner(1, isolated=True) as runner:
        runner.start()
        first = learned(plan, runner, say=said.append)
        assert not needs_learning(first)
        assert json.loads(first.car_model)["logs"] == 16
        file = model_file(plan, None)
        assert list(kept_models().iterdir()) == [file]
        assert "--adversary-model generic" in said[0]
        assert str(file) in said[0]
        other_seed = learned(replace(plan, seed=6, simulations=10), _Nobody(), say=said.append)
        assert other_seed.car_model == first.car_model
        day = datetime.datetime.now(datetime.UTC).date()
        today_or_yesterday = {str(day), str(day - datetime.timedelta(days=1))}
        assert said[1].partition("learned before, on ")[2][:10] in today_or_yesterday
        file.write_text("family: none", encoding="utf-8")
    with InProcessRunner(2) as runner:
        runner.start()
        assert learned(plan, runner).car_model == first.car_model  # what is damaged is learned anew


class _Nobody:
    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        raise AssertionError("there is nothing to run")


class _Aborts:
    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        nothing = np.zeros((1, 2))
        for one in episodes:
            yield EpisodeLog(one, Outcome.ABORTED, nothing, np.zeros((1, 4)), reason="no licence")


def test_a_car_that_cannot_be_run_cannot_be_learned(small_lessons: None) -> None:
    plan = Plan(CROSSING, controller=OWN, adversary_model=AdversaryModel.LEARNED)
    with pytest.raises(AssessmentError, match=r"all 12 probes were aborted \(no licence\)"):
        learned(plan, _Aborts())


# --- How long kamikazes wait for a learned car is what they come to with it, tried against the car.

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
    return learning.with_waiting_reward(PLAN, car, [STANDS], runner, lambda *_told: None)[0].waiting_reward, runner


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
    with pytest.raises(AssessmentError, match=f"all {learning.WAITING_TRIALS} waiting trials were aborted"):
        chosen({one: [math.nan] for one in CHOICES})


@pytest.mark.parametrize("car", [LAW, FOREST])
def test_kamikazes_plan_with_it(car: FittedCar) -> None:
    said = replace(car, waiting_reward=-0.3)
    episode = EpisodeSpec(
        CROSSING, Mode.KAMIKAZE, 0, 0, STANDS, adversary_model=AdversaryModel.LEARNED, car_model=car_model_text(said)
    )
    assert predicted_car(episode).parameters(CROSSING)["waiting_reward"] == -0.3
    silent = replace(episode, car_model=car_model_text(car))
    assert predicted_car(silent).parameters(CROSSING)["waiting_reward"] in CHOICES[:2]
