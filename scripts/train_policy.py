#!/usr/bin/env python3
"""Train the two learned policies of the league, with PPO of stable-baselines3 (pip install stable-baselines3).

    scripts/train_policy.py [--steps 120000] [--seed 0]

`broad` meets pedestrians who cross at any pace, hesitate, stop in the lane, or stay at the kerb for a while. `narrow`
goes on from it with three crossings alone, again and again. A collision costs 20 s and 2 s for each m/s, else time
counts, and hard braking a little.
The weights go to ros_ws/src/skd_sim/skd_sim/controllers/learned_policies.json.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from skd_sim.controllers.reference_drivers import PERIOD, WEIGHTS, LearnedPolicy, acceleration_of, features
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import AdversaryState, CarState, Scene
from stable_baselines3 import PPO

NARROW = (1.2, 1.5, 1.8)  # m/s: paces of the three crossings
LONGEST = 20.0  # s
UNITS = 16


class Crossing(gym.Env):
    """One pedestrian before the car of the scenario crossing; observations and actions are those of the policy."""

    def __init__(self, broad: bool) -> None:
        """Take the scenario."""
        self.observation_space = gym.spaces.Box(-2.0, 2.0, (5,))
        self.action_space = gym.spaces.Box(-1.0, 1.0, (1,))
        self._broad, self._scenario, self._driver = broad, load_scenario("crossing"), LearnedPolicy()

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin a crossing."""
        super().reset(seed=seed)
        car, rng = self._scenario.car, self.np_random
        self._driver.reset(self._scenario, rng)
        self._speed, self._time = car.start_speed, 0.0
        self._pace = rng.uniform(0.4, 2.5) if self._broad else rng.choice(NARROW)
        gap = rng.uniform(10.0, 40.0) if self._broad else 14.0
        side = rng.choice((-1.0, 1.0)) if self._broad else -1.0
        meets = gap / self._speed + (rng.uniform(-1.5, 1.5) if self._broad else 0.0)
        self._y, self._x, self._side = -gap - car.front, side * max(1.2, meets * self._pace), side
        self._stop, self._pause = 9.0, 0.0
        if self._broad and rng.random() < 0.5:
            self._stop, self._pause = rng.uniform(-1.5, 1.5) if rng.random() < 0.7 else -1.8, rng.exponential(2.0)
        return self._seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Go on by a control period."""
        command = acceleration_of(float(action[0]))
        before, desired = self._speed, self._scenario.car.start_speed
        self._speed = min(desired, max(0.0, before + PERIOD * command))
        self._y += 0.5 * PERIOD * (before + self._speed)
        self._time += PERIOD
        waits = -self._side * self._x >= self._stop and self._pause > 0.0
        self._pause -= PERIOD * waits
        self._vx = 0.0 if waits else -self._side * self._pace
        self._x += PERIOD * self._vx
        car, radius = self._scenario.car, self._scenario.adversary.radius or 0.0
        hit = abs(self._x) < car.half_width + radius and -car.rear - radius < -self._y < car.front + radius
        reward = -PERIOD * (1.0 - self._speed / desired) - 0.002 * min(0.0, command) ** 2 * PERIOD
        if hit and self._speed > 0.0:
            reward -= 20.0 + 2.0 * self._speed
        ended = (hit and self._speed > 0.0) or self._y > car.rear
        return self._seen(), reward, bool(ended), self._time > LONGEST, {}

    def _seen(self) -> Any:
        moves = getattr(self, "_vx", 0.0) if self._time else -self._side * self._pace
        car = CarState(0.0, self._y, 0.5 * math.pi, self._speed)
        found = self._driver._situations(car, Scene(car, AdversaryState(self._x, 0.0, moves, 0.0, 0.0)))
        return features(found[0]).astype(np.float32) if found else np.full(5, 2.0, np.float32)


def layers_of(model: PPO) -> list[dict[str, Any]]:
    """Return weights and bias of each layer of the best action's network."""
    linear = [*model.policy.mlp_extractor.policy_net[::2], model.policy.action_net]
    return [{"weights": _rounded(one.weight.T), "bias": _rounded(one.bias)} for one in linear]


def _rounded(values: torch.Tensor) -> Any:
    return values.detach().double().numpy().round(6).tolist()


def main() -> None:
    """Train both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=120_000, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    network = {"net_arch": [UNITS, UNITS], "activation_fn": torch.nn.ReLU}
    sizes: Any = {"gamma": 0.995, "n_steps": 4096, "batch_size": 256}
    model = PPO("MlpPolicy", Crossing(broad=True), policy_kwargs=network, seed=arguments.seed, **sizes)
    found = {}
    for name in ("broad", "narrow"):
        model.set_env(Crossing(broad=name == "broad"))
        model.learn(arguments.steps)
        found[name] = layers_of(model)
    WEIGHTS.write_text(json.dumps(found) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
