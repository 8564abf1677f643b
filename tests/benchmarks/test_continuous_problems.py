"""Models of the planning benchmark whose states or observations are continuous, against facts from outside."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from model_steps import step
from problems import light_dark, van_der_pol_tag
from scipy.integrate import quad, solve_ivp
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.general.closed_loop import play
from skd_adversary.planning.general.model_check import check_model
from skd_sim.kernels.compilation import kernel

SIGMAS = 4.5  # binomial bounds: 7e-6 each, a few hundred of them


# --- LightDark


@pytest.mark.parametrize("position", [-20.0, 0.0, 9.0, 14.0])
def test_light_dark_sees_with_a_density(position: float) -> None:
    model = light_dark.light_dark()
    state = np.array([position])

    def density(seen: float) -> float:
        return float(model.likelihood(model.parameters, state, 0, np.array([seen])))

    sigma = abs(position - 10.0) + 1e-4
    total, _ = quad(density, position - 8.0 * sigma, position + 8.0 * sigma)
    assert total == pytest.approx(math.sqrt(2.0 * math.pi), rel=1e-6)
    rng, seen = np.random.default_rng(7), np.empty((4000, 1))
    for row in seen:
        model.observe(model.parameters, state, 0, row, rng)
    assert abs(seen.mean() - position) <= SIGMAS * sigma / math.sqrt(4000)
    assert abs(seen.std() / sigma - 1.0) <= SIGMAS / math.sqrt(8000)


def test_light_dark_moves_stops_and_is_judged() -> None:
    model = light_dark.light_dark()
    assert step(model, [3.0], 4) == (-1.0, False, [13.0])
    assert step(model, [-55.0], 0) == (-1.0, False, [-60.0])
    assert step(model, [0.0], light_dark.STOP)[:2] == (100.0, True)
    assert step(model, [1.0], light_dark.STOP)[:2] == (-100.0, True)


def test_light_dark_by_the_light() -> None:
    values, _ = light_dark.values_by_the_light(60, 10)
    home = -1.0 + 0.95 * 100.0  # from the light: −10, then stop
    assert values[60 + 10] == pytest.approx(home)
    assert values[60] == pytest.approx(-1.0 + 0.95 * home)
    assert values[60 + 12] == pytest.approx(-1.0 + 0.95 * (-1.0 + 0.95 * home))


# --- Van der Pol Tag


def test_barriers_of_van_der_pol_tag_stop_the_agent() -> None:
    """They lie on the axes, from 0.2 to 3 on either side: between them and beyond them is a way."""
    p = van_der_pol_tag.van_der_pol_tag().parameters
    for quarter in range(4):
        turned = complex(math.cos(quarter * math.pi / 2.0), math.sin(quarter * math.pi / 2.0))

        def walk(x: float, y: float, degrees: float, turned: complex = turned, quarter: int = quarter) -> complex:
            begin = complex(x, y) * turned
            angle = math.radians(degrees) + quarter * math.pi / 2.0
            return complex(*van_der_pol_tag.walked(p, begin.real, begin.imag, angle)) / turned

        assert walk(1.0, 0.1, -90.0) == pytest.approx(1.0, abs=1e-9)
        assert walk(1.0, 0.1, -45.0) == pytest.approx(1.1, abs=1e-9)
        assert walk(0.1, 0.1, -90.0) == pytest.approx(0.1 - 0.4j)
        assert walk(3.1, 0.1, -90.0) == pytest.approx(3.1 - 0.4j)
        assert walk(1.0, 0.6, -90.0) == pytest.approx(1.0 + 0.1j)
        assert walk(1.0, 1e-12, 90.0) == pytest.approx(1.0 + 0.5j)


def test_van_der_pol_tag_moves_tags_and_looks() -> None:
    """The target goes as the oscillator does, integrated by another hand; what is near then is tagged."""
    model = van_der_pol_tag.van_der_pol_tag()
    check_model(model)
    p, rng = model.parameters, np.random.default_rng(6)

    def oscillator(_time: float, at: np.ndarray) -> list[float]:
        return [2.0 * (at[0] - at[0] ** 3 / 3.0 - at[1]), at[0] / 2.0]

    for x, y in ((0.5, 0.5), (1.8, -0.6), (-1.0, 2.0)):
        exact = solve_ivp(oscillator, (0.0, 0.5), [x, y], rtol=1e-10, atol=1e-10).y[:, -1]
        assert van_der_pol_tag.carried(p, x, y) == pytest.approx(exact, abs=2e-3)
        state, after, targets = np.array([2.0, 2.0, x, y]), np.empty(4), []
        for _ in range(500):
            reward, ended = model.step(p, state, np.array([1.0, 0.0]), after, rng)
            assert (reward, ended) == (-6.0, False)
            targets.append(after[2:].copy())
        assert np.mean(targets, axis=0) == pytest.approx(exact, abs=2e-3 + SIGMAS * 0.05 / math.sqrt(500.0))
        assert np.std(targets, axis=0) == pytest.approx(0.05, rel=0.15)
        side = math.copysign(1.0, exact[0])  # from there no barrier is in the way
        near, towards = np.array([exact[0] + 0.5 * side, exact[1], x, y]), math.pi if side > 0.0 else 0.0
        ends = [model.step(p, near, np.array([0.0, towards]), after, rng) for _ in range(500)]
        assert set(ends) == {(100.0, True), (-1.0, False)}
        tagged = 1.0 - math.exp(-0.5 * (0.1 / 0.05) ** 2)  # Rayleigh's distribution
        share = np.mean([ended for _, ended in ends])
        assert share == pytest.approx(tagged, abs=SIGMAS * math.sqrt(tagged * (1.0 - tagged) / 500.0) + 0.02)


def test_beams_of_van_der_pol_tag() -> None:
    model, rng = van_der_pol_tag.van_der_pol_tag(), np.random.default_rng(7)
    for degrees, beam in ((10.0, 0), (100.0, 2), (-10.0, 7), (179.0, 3)):
        angle = math.radians(degrees)
        state = np.array([1.0, -1.0, 1.0 + 2.0 * math.cos(angle), -1.0 + 2.0 * math.sin(angle)])
        for look, sigma in ((1.0, 0.1), (0.0, 5.0)):
            seen = np.empty((2000, 8))
            for one in seen:
                model.observe(model.parameters, state, np.array([look, 0.0]), one, rng)
            means, sigmas = np.ones(8), np.full(8, 5.0)
            means[beam], sigmas[beam] = 2.0, sigma
            assert (np.abs(seen.mean(axis=0) - means) <= SIGMAS * sigmas / math.sqrt(2000.0)).all()
            assert seen.std(axis=0) == pytest.approx(sigmas, rel=0.1)


@kernel
def _by_belief(p: Any, particles: np.ndarray, i: int) -> float:
    return van_der_pol_tag.towards_target(p, particles[i])


def test_a_policy_on_van_der_pol_tag_earns_what_is_published() -> None:
    """To go where the target will be, by a state of the belief, is worth −17.05 ± 0.38 (σ = 12.1 of an episode)."""
    model = van_der_pol_tag.van_der_pol_tag()

    class ToNext:
        def __init__(self, rng: np.random.Generator) -> None:
            self.rng = rng

        def plan(self, belief: ParticleBelief) -> np.ndarray:
            drawn = int(np.searchsorted(np.cumsum(belief.weights), self.rng.random() * 0.999999))
            return np.array([0.0, _by_belief(model.parameters, belief.particles, drawn)])

        def advance(self, action: np.ndarray, observation: np.ndarray) -> None:
            pass

    values, count = [], 60
    for seed in range(count):
        rng = np.random.default_rng([4, seed])
        values.append(play(model, ParticleBelief(model, 500, rng), ToNext(rng), rng, moves=100).value)
    assert abs(np.mean(values) + 17.05) <= 3.5 * math.hypot(12.1 / math.sqrt(count), 0.38)
