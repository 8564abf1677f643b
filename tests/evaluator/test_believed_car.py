"""What a kamikaze believed of the car: recorded tick by tick, read back, drawn; its trajectory is the same."""

import numpy as np
from skd_adversary.adversary import make_adversary
from skd_adversary.crossing.interfaces import CAR_S, CAR_SPEED
from skd_evaluator import Plan, run_episode
from skd_evaluator.assessment.files.episodes_npz import read_episodes
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories, single_episode
from skd_sim import Mode, load_scenario


def test_it_is_mean_and_deviation_of_the_particles_and_changes_nothing():
    plan = Plan(load_scenario("crossing"), safe_count=1, simulations=30)
    (safe,) = safe_trajectories(plan, InProcessRunner(1))
    episode = single_episode(plan, Mode.KAMIKAZE, 0, safe)
    seen = []

    class Watched:
        """Nobody of whom a belief is asked for: the same adversary behind another name."""

        depletions = 0

        def __init__(self) -> None:
            self._inner = make_adversary(episode)

        def act(self, car):
            velocity = self._inner.act(car)
            belief = self._inner.belief
            for column in (CAR_S, CAR_SPEED):
                values = belief.particles[:, column]
                mean = np.average(values, weights=belief.weights)
                seen.append((mean, np.average((values - mean) ** 2, weights=belief.weights) ** 0.5))
            return velocity

    log, other = run_episode(episode), run_episode(episode, adversary=Watched())
    assert log.adversary.tobytes() == other.adversary.tobytes()
    assert log.car.tobytes() == other.car.tobytes()
    assert other.belief is None
    assert log.belief.shape == (len(log.adversary), 4)
    assert np.isnan(log.belief[-1]).all()
    np.testing.assert_allclose(log.belief[:-1], np.array(seen).reshape(-1, 4), rtol=1e-9, atol=1e-9)


def test_it_is_in_the_file_and_agrees_with_where_the_car_is(sweep):
    """A filter that knows the car is off by its own deviations: by a tick more it would be off by five."""
    stored, scores = read_episodes(sweep / "synthetic" / "C_1"), []
    for number in range(len(stored)):
        belief, car = stored.belief[number], stored.car[number]
        assert len(belief) == len(car)
        if stored.mode[number] != Mode.KAMIKAZE:
            assert np.isnan(belief).all()
            continue
        assert np.isfinite(belief[:-1]).all()
        assert np.isnan(belief[-1]).all()
        scores.append((belief[:-1, 0] - car[:-1, 1]) / np.maximum(belief[:-1, 1], 0.05))
    together = np.concatenate(scores)
    assert len(together) > 150
    assert (np.abs(together) < 3.0).mean() > 0.95
    assert abs(together.mean()) < 0.35
    assert 0.5 < together.std() < 1.5
