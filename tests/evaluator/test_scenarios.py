"""Episodes on a curved road and with a box for an adversary: run, judged, stored, recomputed, drawn."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from skd_adversary.safe_trajectories.sources import read_csv_trajectory
from skd_evaluator.assessment.plan import EpisodeGroup, episode_id
from skd_evaluator.assessment.plausibility import examine
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.margin.actions import has_exact_margin
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.simulators.simulator import FramedSimulator, FrameSource
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

RIGHT_TURN, CROSSING = load_scenario("right_turn"), load_scenario("crossing")
BOX = replace(CROSSING.adversary, radius=None, length=1.8, width=0.6)
WITH_BOX = replace(CROSSING, adversary=BOX)
pytestmark = pytest.mark.usefixtures("pictures_drawn")
TURN_WITH_BOX = replace(RIGHT_TURN, adversary=replace(BOX, start_x=-4.5))


def across(scenario: Scenario, speed: float = 2.5) -> Trajectory:
    x = np.minimum(-4.5 + speed * scenario.time_step * np.arange(16), 2.5)
    return Trajectory(np.column_stack([x, np.zeros_like(x)]), scenario.time_step, "by hand")


def replays(scenario: Scenario, count: int, *, controller: str = "basic", C: float = 1.0) -> list[EpisodeLog]:
    phi = across(scenario)
    numbers = [episode_id(EpisodeGroup.NOMINAL, 0, trial) for trial in range(count)]
    car = {"controller": controller, "multiplier": C}
    return [run_episode(EpisodeSpec(scenario, Mode.REPLAY, 0, number, phi, **car)) for number in numbers]


@pytest.mark.parametrize("scenario", [RIGHT_TURN, WITH_BOX, TURN_WITH_BOX], ids=["turn", "box", "turn with a box"])
def test_what_ran_is_believed_and_what_did_not_is_not(scenario: Scenario) -> None:
    logs = replays(scenario, 12, C=0.5) + replays(scenario, 4, C=1.15)
    assert {log.outcome for log in logs} >= {Outcome.COLLISION}
    for log in logs:
        verdict = examine(log)
        assert verdict.ours, verdict
    hit = next(log for log in logs if log.outcome == Outcome.COLLISION)
    assert not examine(replace(hit, impact_time=hit.impact_time - 0.01)).ours
    moved = hit.car.copy()
    moved[1:, :2] += 0.05
    assert not examine(replace(hit, car=moved)).ours
    assert examine(replace(hit, adversary=hit.adversary + np.array([0.0, 8.0]))).fault


@pytest.mark.parametrize("scenario", [RIGHT_TURN, TURN_WITH_BOX], ids=["disc", "box"])
def test_the_agent_of_carla_drives_around_the_corner(scenario: Scenario) -> None:
    logs = replays(scenario, 3, controller="carla")
    assert all(log.outcome in (Outcome.ARRIVED, Outcome.COLLISION) and not examine(log).fault for log in logs)


def test_who_cannot_do_it_says_so() -> None:
    with pytest.raises(UsageError, match="controller cal has learned hazards on straight roads"):
        replays(replace(RIGHT_TURN, control_period=0.05), 1, controller="cal")
    episode = EpisodeSpec(RIGHT_TURN, Mode.REPLAY, 0, 0, safe_trajectory=across(RIGHT_TURN))
    with pytest.raises(UsageError, match="another simulator does not know yet"):
        FramedSimulator(cast(FrameSource, None)).reset(episode)  # before its source is asked anything
    assert not any(has_exact_margin(CarUnderTest("basic"), scenario) for scenario in (RIGHT_TURN, WITH_BOX))


def test_a_trajectory_of_ones_own_has_to_cross_the_curved_lane(tmp_path: Path) -> None:
    def read(*points: tuple[float, float]) -> Trajectory:
        file = tmp_path / "own.csv"
        file.write_text("t,x,y\n" + "".join(f"{1.2 * i},{x},{y}\n" for i, (x, y) in enumerate(points)))
        return read_csv_trajectory(file, RIGHT_TURN)

    # In the curve the lane runs from (8, −11.9) to (0, −3.9): from inside out is from the right to the left of it.
    assert len(read((0.0, -9.5), (2.0, -7.5), (4.0, -5.5))) == 9
    with pytest.raises(UsageError, match=r"walks left, from x = .*: mirror it"):
        read((4.0, -5.5), (2.0, -7.5), (0.0, -9.5))
    with pytest.raises(UsageError, match=r"never enters the car's path \(1\.15 m to each side of the road's centre"):
        read((-5.0, -9.0), (-3.0, -9.0), (-3.0, -7.0))
    with pytest.raises(UsageError, match="where the car starts"):
        read((3.4, -10.5), (5.0, -8.0))
