"""MetaDrive as a simulator: it brakes as told, moves whom it is told to, repeats itself, and its expert is its own.

Skipped where MetaDrive is not installed; where it is: `scripts/test tests/sim/test_metadrive.py`.
"""

import importlib.util
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from common import run_skd
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Scenario, Trajectory, UsageError, load_scenario

if importlib.util.find_spec("metadrive") is None:
    pytest.skip("MetaDrive is not installed: python -m pip install '.[metadrive]'", allow_module_level=True)

from skd_sim.simulators.metadrive.simulator import MetaDriveSimulator

CROSSING = load_scenario("crossing")
CARS = {"basic": None, "cal": 0.05, "carla": None, "metadrive_expert": 0.1}


@pytest.fixture(scope="module", autouse=True)
def ended() -> Iterator[None]:
    """End the engine of this process, so that modules after this one may fork it."""
    yield
    from skd_sim.simulators.metadrive.stage import end

    end()


def still(x: float, y: float = 0.0, ticks: int = 20) -> Trajectory:
    return Trajectory(np.tile((x, y), (ticks + 1, 1)), CROSSING.time_step, "still")


def across(pace: float = 2.5, ticks: int = 20) -> Trajectory:
    x = np.minimum(-3.5 + pace * CROSSING.time_step * np.arange(ticks + 1), 2.5)
    return Trajectory(np.column_stack([x, np.zeros_like(x)]), CROSSING.time_step, "across")


def run(phi: Trajectory, car: str = "basic", number: int = 0, scenario: Scenario = CROSSING, **more: Any) -> EpisodeLog:
    scenario = replace(scenario, control_period=CARS[car])
    episode = EpisodeSpec(scenario, Mode.REPLAY, 3, number, controller=car, safe_trajectory=phi, simulator="metadrive")
    return run_episode(episode, **more)


class Brakes:
    def __init__(self, deceleration: float) -> None:
        self.deceleration = deceleration

    def reset(self, scenario, rng) -> None:
        pass

    def command(self, car, adversary) -> float:
        return -self.deceleration


@pytest.mark.parametrize("deceleration", [3.5, 6.0])
@pytest.mark.parametrize("mass", [None, 1800.0])
def test_stops_are_as_long_as_the_closed_form_says(deceleration: float, mass: float | None) -> None:
    """From 30 km/h, and then it stands: it does not tremble, and its springs swing it by less than a decimetre."""
    scenario = replace(CROSSING, car=replace(CROSSING.car, mass=mass))
    log = run(still(-80.0), scenario=scenario, controller=Brakes(deceleration))
    stopped = int(np.argmax(log.car[:, 3] < 0.02))
    way = log.car[stopped, 1] - log.car[0, 1]
    assert way == pytest.approx(CROSSING.car.start_speed**2 / (2.0 * deceleration), rel=0.05)
    assert log.car[stopped:, 3].max() < 0.02
    assert abs(log.car[-1, 1] - log.car[stopped, 1]) < 0.1


def test_the_adversary_is_where_it_was_commanded() -> None:
    """By SKD to the last bit, and by MetaDrive, whose numbers have 24 bits, within a hundredth of a millimetre."""
    simulator = MetaDriveSimulator()
    log = run(across(), simulator=simulator)
    np.testing.assert_allclose(log.adversary, across().positions[: len(log.adversary)], atol=1e-12)
    assert 0.0 < simulator.position_error < 1e-5


def test_both_find_the_contact_and_it_moves_nobody() -> None:
    """Somebody stands in the lane of a car that does not brake: the time follows from the way, the speed stays."""
    log = run(still(0.0), controller=Brakes(0.0))
    gap = -log.car[0, 1] - CROSSING.car.front - CROSSING.adversary.shape[0]
    assert log.outcome == Outcome.COLLISION
    assert log.impact_time == pytest.approx(gap / CROSSING.car.start_speed, abs=0.01)
    assert log.impact_speed == pytest.approx(CROSSING.car.start_speed, abs=1e-3)
    assert log.own_contact == pytest.approx(log.impact_time, abs=0.03)
    assert log.car[-1, 3] == pytest.approx(CROSSING.car.start_speed, abs=1e-3)
    assert np.isnan(run(still(-80.0, ticks=3)).own_contact)


def test_it_repeats_itself_to_the_last_bit() -> None:
    """Whatever ran before, contact or not: with other cars, control periods and vehicles in between."""
    wanted = [(phi, car, number) for number in range(2) for car in CARS for phi in (across(1.5), still(-3.0))]
    first = [run(*one) for one in wanted]
    run(across(), scenario=replace(CROSSING, car=replace(CROSSING.car, mass=2000.0)))
    again = [run(*one) for one in reversed(wanted)][::-1]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.car, other.car)
        np.testing.assert_equal((one.impact_time, one.own_contact), (other.impact_time, other.own_contact))
    assert {log.outcome for log in first} >= {Outcome.COLLISION, Outcome.ARRIVED}


@pytest.mark.parametrize("name", ["cyclist", "bystanders", "cpnco", "cut_in"])
def test_boxes_others_and_parked_cars_are_there(name: str) -> None:
    """The car drives into whom it would drive into: as in SKD's world without its noise, for it does not brake."""
    base = load_scenario(name)
    scenario = replace(base, car=replace(base.car, speed_noise=0.0, acceleration_noise=0.0), control_period=None)
    here = np.array([base.adversary.start_x, base.adversary.start_y])
    phi = Trajectory(here + np.zeros((21, 1)), base.time_step, "stands")
    episode = EpisodeSpec(scenario, Mode.REPLAY, 3, 0, safe_trajectory=phi, simulator="metadrive")
    there = run_episode(episode, controller=Brakes(0.0))
    expected = run_episode(replace(episode, simulator="world"), controller=Brakes(0.0))
    assert there.outcome == expected.outcome
    np.testing.assert_allclose(there.impact_time, expected.impact_time, atol=0.02)
    np.testing.assert_allclose(there.car[:, 1], expected.car[:, 1], atol=0.05)


def test_a_fork_of_a_process_with_an_engine_is_refused() -> None:
    run(still(-80.0, ticks=1))
    child = os.fork()
    if child == 0:
        code = 1
        try:
            run(still(-80.0, ticks=1))
        except UsageError as error:
            code = 0 if "forked" in str(error) else 2
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_the_expert_draws_from_what_metadrives_own_code_says() -> None:
    """Its mean at every decision of two episodes is that of MetaDrive's own function, at the same moment."""
    from metadrive.examples.ppo_expert import numpy_expert
    from skd_sim.simulators.metadrive.simulator import MetaDriveExpert, distribution

    found = []

    class Compared(MetaDriveExpert):
        def command(self, car, adversary) -> float:
            answer = super().command(car, adversary)
            mine = distribution(self._observation.observe(self._stage.car))[0]
            found.append((mine, numpy_expert.expert(self._stage.car, deterministic=True)))
            return answer

    for phi in (across(), still(-80.0, ticks=5)):
        run(phi, "metadrive_expert", controller=Compared())
    assert len(found) > 20
    for mine, own in found:
        np.testing.assert_array_equal(mine, own)


def test_the_expert_needs_metadrive_to_simulate() -> None:
    wider = replace(CROSSING, control_period=0.1, adversary=replace(CROSSING.adversary, radius=0.3))
    episode = EpisodeSpec(wider, Mode.REPLAY, 3, 0, controller="metadrive_expert", safe_trajectory=across())
    with pytest.raises(UsageError, match="use it with --simulator metadrive"):
        run_episode(episode)  # in SKD's world, of which the MetaDrive that runs here knows nothing


def test_an_assessment_has_all_its_parts_and_keeps_the_pedals(tmp_path) -> None:
    """In workers, none of which has an engine from here."""
    from skd_sim.simulators.metadrive.stage import end

    end()
    out = tmp_path / "out"
    words = ("--safe-count", 2, "--kamikaze-count", 2, "--collision-runs", 4, "--simulations", 100)
    code = run_skd("assess", "--simulator", "metadrive", *words, "--workers", 2, "--out", out, "-q", "--no-pictures")
    result = json.loads((out / "assessment.json").read_text())
    assert (code, result["aborted"]) == (0, 0)
    assert result["margin"] is not None
    assert result["risk"]["scales"][0]["aborted"] == 0
    assert result["simulation"]["version"] == "0.4.3"
    assert len(result["simulation"]["pedals"]["brake"]) == 14
    assert result["simulator_contacts"]["geometry_alone"] == 0
    assert run_skd("verify", out) == 0


class Steers:
    """Commands one steering angle."""

    def __init__(self, angle: float) -> None:
        self.angle = angle

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Nothing is kept."""

    def command(self, car: Any, adversary: Any) -> tuple[float, float]:
        return 0.0, self.angle


@pytest.mark.parametrize("angle", [0.02, -0.02])
def test_it_steers_to_the_side_that_is_commanded_by_about_as_much_as_the_worlds_car(angle: float) -> None:
    wide = replace(CROSSING, road=replace(CROSSING.road, lane_width=40.0))
    logs = [run(still(-30.0, ticks=9), scenario=wide, controller=Steers(angle))]
    logs.append(run_episode(replace(logs[0].episode, simulator="world"), Steers(angle)))
    there, here = (float(log.car[-1, 2]) - np.pi / 2.0 for log in logs)
    assert np.sign(there) == np.sign(angle)
    assert there == pytest.approx(here, rel=0.3)
