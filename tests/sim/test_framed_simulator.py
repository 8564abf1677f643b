"""An episode that is watched frame by frame means by a contact, a tick and an end what the world means by them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import Other
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.simulators.simulator import Frame, FramedSimulator, Simulator, WorldSimulator
from skd_sim.world.dynamics.basic import STEERING_LIMIT, BasicCar, Command, CommandLimits, Noise
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, RoadUserState, on_grid

FRAME = 0.05


class Uniform:
    """Frames of a car and an adversary that do what they are told, exactly; a box points the way it moves."""

    limits = CommandLimits(-8.0, 4.0)

    def __init__(self, frame_step: float = FRAME) -> None:
        self.frame_step = frame_step
        self.commands: list[float] = []
        self.shown: list[tuple[RoadUserState, ...]] = []

    def prepare(self, scenario: Scenario) -> None:
        self._scenario = scenario

    def show(self, others: Sequence[RoadUserState]) -> None:
        self.shown.append(tuple(others))

    def place(self, car: CarState, adversary: AdversaryState) -> tuple[CarState, AdversaryState]:
        self._car, self._adversary = car, adversary
        return car, adversary

    def control(self, acceleration: float, steering: float, velocity: tuple[float, float]) -> None:
        self.commands.append(acceleration)
        self._velocity = velocity

    def advance(self) -> tuple[CarState, AdversaryState]:
        car, adversary, (vx, vy), step = self._car, self._adversary, self._velocity, self.frame_step
        after = max(0.0, car.speed + step * self.commands[-1])
        self._car = car._replace(y=car.y + 0.5 * step * (car.speed + after), speed=after)
        heading = float(on_grid(self._scenario.adversary.heading(adversary.heading, vx, vy)))
        self._adversary = AdversaryState(adversary.x + step * vx, adversary.y + step * vy, vx, vy, heading)
        return self._car, self._adversary


def _scenario(gap: float) -> Scenario:
    """The crossing with a car that drives on without noise."""
    base = load_scenario("crossing")
    return replace(base, car=replace(base.car, speed_noise=0.0, acceleration_noise=0.0, start_gap=gap))


def _run(simulator: Simulator, episode: EpisodeSpec, velocity: tuple[float, float], command: Command = 0.0) -> Frame:
    frame = simulator.reset(episode)
    while frame.outcome == Outcome.RUNNING:
        frame = simulator.step(command, velocity)
    return frame


@pytest.mark.parametrize("period", [None, 0.15, 0.05])
@pytest.mark.parametrize("episode_id", range(12))
def test_same_end_as_in_the_world(episode_id: int, period: float | None) -> None:
    """Whether the car decides once a tick or every few frames."""
    rng = np.random.default_rng(episode_id)
    velocity = (rng.uniform(1.5, 2.5), rng.uniform(-0.5, 0.5))
    scenario = replace(_scenario(rng.uniform(8.0, 16.0)), control_period=period)
    episode = EpisodeSpec(scenario, Mode.SAFE, 7, episode_id)
    there = _run(WorldSimulator(), episode, velocity)
    seen = _run(FramedSimulator(Uniform()), episode, velocity)
    assert (seen.outcome, seen.tick, seen.period) == (there.outcome, there.tick, 0)
    assert seen.adversary == pytest.approx(there.adversary, abs=1e-9)
    if there.contact is None:
        assert seen.contact is None
        assert seen.car == pytest.approx(there.car, abs=1e-9)
    else:
        assert seen.contact == pytest.approx(there.contact, abs=1e-9)
        assert seen.impact(0.3) == pytest.approx(there.impact(0.3), abs=1e-9)


@pytest.mark.parametrize("name", ["cyclist", "bystanders", "cut_in"])
def test_boxes_and_others_end_as_in_the_world(name: str) -> None:
    """Of many ways, some that touch the adversary, some that touch one of the others, and some that touch nobody."""
    rng = np.random.default_rng(5)
    base = load_scenario(name)
    touched, passed = 0, 0
    for number in range(40):
        car = replace(base.car, speed_noise=0.0, acceleration_noise=0.0)
        walks = {"others": tuple(_crossing_early(other) for other in base.others)} if number % 2 else {}
        episode = EpisodeSpec(replace(base, car=car, control_period=0.1, horizon=5.0, **walks), Mode.SAFE, 7, number)
        direction = base.adversary.start_heading or 0.0
        angle, speed = direction + rng.uniform(-0.5, 0.5), rng.uniform(0.1, 0.9) * base.adversary.speed
        velocity = (speed * float(np.cos(angle)), speed * float(np.sin(angle)))
        there = _run(WorldSimulator(), episode, velocity)
        source = Uniform()
        seen = _run(FramedSimulator(source), episode, velocity)
        assert (seen.outcome, seen.tick) == (there.outcome, there.tick), number
        assert seen.adversary == pytest.approx(there.adversary, abs=1e-9)
        assert (seen.contact is None) == (there.contact is None)
        if there.contact is not None:
            assert seen.contact == pytest.approx(there.contact, abs=1e-9)
        else:
            np.testing.assert_allclose(source.shown[-1], episode.scenario.others_at(there.tick), atol=1e-9)
        touched, passed = touched + (there.contact is not None), passed + (there.contact is None)
    assert min(touched, passed) >= 3, (touched, passed)


def _crossing_early(other: Other) -> Other:
    """Return one that walks over the car's lane, so that the car runs into it if nobody else comes first."""
    if other.is_box or other.stands:
        return other
    return replace(other, way=tuple(replace(point, x=2.0 * point.time - 4.0, y=4.0) for point in other.way))


class Bicycle(Uniform):
    """The same with the world's own car, which steers."""

    def place(self, car: CarState, adversary: AdversaryState) -> tuple[CarState, AdversaryState]:
        self._dynamics = BasicCar(self._scenario)
        self._dynamics.reset(car)
        return super().place(car, adversary)

    def control(self, acceleration: float, steering: float, velocity: tuple[float, float]) -> None:
        super().control(acceleration, steering, velocity)
        self._steering = steering

    def advance(self) -> tuple[CarState, AdversaryState]:
        _, adversary = super().advance()
        path = self._dynamics.advance((self.commands[-1], self._steering), self.frame_step, Noise(0.0, 0.0))
        self._car = CarState(*path[-1].tolist())
        return self._car, adversary


@pytest.mark.parametrize("angle", [0.01, 0.1, 2.0])
def test_a_car_that_steers_leaves_the_road_where_it_does_in_the_world(angle: float) -> None:
    """Up to a frame later: a frame is looked at when it ends."""
    episode = EpisodeSpec(replace(_scenario(30.0), control_period=0.05), Mode.SAFE, 7, 0)
    there, seen = FramedSimulator(Bicycle()), WorldSimulator()
    ends = [_run(one, episode, (0.0, 0.0), (0.0, angle)) for one in (there, seen)]
    assert [end.outcome for end in ends] == [Outcome.COLLISION] * 2
    assert ends[0].impact(0.3)[0] == pytest.approx(ends[1].impact(0.3)[0], abs=0.051)
    assert (there.clipped > 0) == (angle > STEERING_LIMIT)


class Feeling(Uniform):
    """The same with a contact of its own: from the first frame on in which the car's front is beyond a place."""

    def touching(self) -> bool:
        return self._car.y + 2.25 > -4.0


@pytest.mark.parametrize("least_speed", [0.0, 20.0])
def test_a_source_says_when_its_own_shapes_touch(least_speed: float) -> None:
    """It does not end the episode; one of too slow a car is none."""
    base = _scenario(10.0)
    scenario = replace(base, collision=replace(base.collision, minimum_impact_speed=least_speed))
    simulator = FramedSimulator(Feeling())
    begin = simulator.reset(EpisodeSpec(scenario, Mode.SAFE, 7, 0))
    while simulator.step(0.0, (0.0, 0.0)).tick < 5:
        pass
    reached = (-4.0 - 2.25 - begin.car.y) / begin.car.speed
    expected = np.ceil(reached / FRAME) * FRAME if least_speed == 0.0 else np.nan
    np.testing.assert_allclose(simulator.own_contact, expected)
    assert FramedSimulator(Uniform()).own_contact is None


def test_commands_beyond_its_limits_are_clipped_and_counted() -> None:
    source = Uniform()
    simulator = FramedSimulator(source)
    end = _run(simulator, EpisodeSpec(_scenario(30.0), Mode.SAFE, 7, 0), (2.5, 0.0), -11.0)
    assert set(source.commands) == {-8.0}
    assert simulator.clipped == end.tick
    _run(simulator, EpisodeSpec(_scenario(30.0), Mode.SAFE, 7, 1), (2.5, 0.0), -8.0)
    assert simulator.clipped == 0


def test_a_control_period_has_whole_frames() -> None:
    episode = EpisodeSpec(replace(_scenario(13.0), control_period=0.02), Mode.SAFE, 0, 0)
    with pytest.raises(UsageError, match=r"must divide the scenario's time_step 0\.3 s and its control_period 0\.02 s"):
        FramedSimulator(Uniform()).reset(episode)
