"""Two policies of reinforcement learning: one of many crossings, and one overtrained on three.

scripts/train_policy.py trains them (PPO of stable-baselines3) and writes their weights beside this module: two layers
of 16. They are small, and no match for what others train: they show what a rating says of such a car.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

from skd_sim.controllers.reference_drivers import PERIOD, RESUME, ReferenceDriver, RelativeState
from skd_sim.world.state import FloatArray

WEIGHTS = Path(__file__).with_name("learned_policies.json")
HARDEST = 8.0  # m/s², braking at an output of −1; an output of 1 is `RESUME`
_SCALES = np.array([20.0, 3.0, 8.0, 2.5, 2.5])


def features(one: RelativeState) -> FloatArray:
    """Return what a policy sees of a road user: gap, distance aside, and the speeds, 5 numbers of about 1."""
    seen = np.array([one.gap, one.aside, one.speed, one.lead, one.closing]) / _SCALES
    return np.asarray(np.minimum(np.maximum(seen, -2.0), 2.0))


def acceleration_of(output: float) -> float:
    """Return the acceleration (m/s²) for an output of a policy, which is clipped to −1 … 1."""
    return RESUME - 0.5 * (HARDEST + RESUME) * (1.0 - min(1.0, max(-1.0, output)))


class LearnedPolicy(ReferenceDriver):
    """A policy that brakes for each road user ahead as it was trained to."""

    policy = "broad"

    def _answer(self, speed: float, found: list[RelativeState]) -> float:
        """Return the least acceleration (m/s²) that any road user calls for."""
        free = min(RESUME, max(-RESUME, (self._desired - speed) / PERIOD))
        return min([free, *(acceleration_of(self._output(features(one))) for one in found)])

    def is_critical(self, one: RelativeState) -> bool:
        """Tell that the policy decides about everybody."""
        return True

    def _output(self, values: FloatArray) -> float:
        layers = _layers(self.policy)
        for weights, bias in layers[:-1]:
            values = np.maximum(_dot(weights, values) + bias, 0.0)
        weights, bias = layers[-1]
        return float((_dot(weights, values) + bias)[0])


class OvertrainedPolicy(LearnedPolicy):
    """The same network, trained on three crossings alone."""

    policy = "narrow"


def _dot(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Return a product, summed input by input: the same bits on every machine, which no BLAS promises."""
    return np.asarray(np.sum(weights * values[:, None], axis=0))


@functools.cache
def _layers(policy: str) -> list[tuple[FloatArray, FloatArray]]:
    """Return weights, inputs × outputs, and bias of each layer."""
    found: list[Any] = json.loads(WEIGHTS.read_text(encoding="utf-8"))[policy]
    return [(np.array(one["weights"]), np.array(one["bias"])) for one in found]
