"""Training of the hazard network: Adam on the logarithmic loss.

Written out as loops: every sum has a fixed order, so the same seed gives the same weights whatever the machine's BLAS
and number of cores.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skd_sim.hazard.network import HazardNetwork
from skd_sim.kernels.compilation import kernel

FloatArray = NDArray[np.float64]
Layers = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""w1, b1, w2, b2, w3, b3, as in `HazardNetwork`."""


@dataclass(frozen=True)
class TrainingOptions:
    """How to train.

    Attributes:
        hidden: units of each hidden layer.
        epochs: passes through the data.
        batch: samples per step.
        learning_rate: learning rate of the first step; it falls to zero like half a cosine.
    """

    hidden: int = 64
    epochs: int = 90
    batch: int = 64
    learning_rate: float = 3e-3


@kernel
def _add_gradient(
    x: FloatArray,
    label: float,
    weights: Layers,
    gradient: Layers,
    work: FloatArray,
) -> None:
    """Add one sample's gradient of the logarithmic loss; `work` is 4 × hidden."""
    w1, b1, w2, b2, w3, b3 = weights
    g1, gb1, g2, gb2, g3, gb3 = gradient
    hidden = len(b1)
    first, second, back_first, back_second = work[0], work[1], work[2], work[3]
    first[:] = b1
    for i in range(len(x)):
        for j in range(hidden):
            first[j] += x[i] * w1[i, j]
    second[:] = b2
    for i in range(hidden):
        if first[i] > 0.0:
            for j in range(hidden):
                second[j] += first[i] * w2[i, j]
    logit = b3[0]
    for i in range(hidden):
        if second[i] > 0.0:
            logit += second[i] * w3[i, 0]
    error = 1.0 / (1.0 + math.exp(-logit)) - label
    gb3[0] += error
    for i in range(hidden):
        active = second[i] > 0.0
        back_second[i] = error * w3[i, 0] if active else 0.0
        if active:
            g3[i, 0] += error * second[i]
        gb2[i] += back_second[i]
    for i in range(hidden):
        back_first[i] = 0.0
        if first[i] > 0.0:
            for j in range(hidden):
                g2[i, j] += first[i] * back_second[j]
                back_first[i] += w2[i, j] * back_second[j]
        gb1[i] += back_first[i]
    for i in range(len(x)):
        for j in range(hidden):
            g1[i, j] += x[i] * back_first[j]


@kernel
def _adam(
    weights: FloatArray, gradient: FloatArray, mean: FloatArray, square: FloatArray, rate: float, step: int
) -> None:
    """Move flat `weights` by one step of Adam (Kingma and Ba 2015, with its default constants); clear `gradient`."""
    decay_mean = 1.0 - 0.9**step
    decay_square = 1.0 - 0.999**step
    for i in range(len(weights)):
        mean[i] = 0.9 * mean[i] + 0.1 * gradient[i]
        square[i] = 0.999 * square[i] + 0.001 * gradient[i] * gradient[i]
        weights[i] -= rate * (mean[i] / decay_mean) / (math.sqrt(square[i] / decay_square) + 1e-8)
        gradient[i] = 0.0


@kernel
def _epoch(
    features: FloatArray,
    labels: FloatArray,
    order: NDArray[np.int64],
    batch: int,
    rates: FloatArray,
    first_step: int,
    weights: Layers,
    gradient: Layers,
    flat: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Pass once through the data in the given order; `flat` is (weights, gradient, mean, square), each flat."""
    work = np.empty((4, len(weights[1])))
    step = first_step
    for begin in range(0, len(order), batch):
        end = min(begin + batch, len(order))
        for index in order[begin:end]:
            _add_gradient(features[index], labels[index], weights, gradient, work)
        flat[1][:] /= end - begin
        step += 1
        _adam(flat[0], flat[1], flat[2], flat[3], rates[step - 1], step)


def _views(flat: FloatArray, inputs: int, hidden: int) -> Layers:
    """Return the six weight arrays as views of one flat array."""
    views: list[FloatArray] = []
    at = 0
    for shape in ((inputs, hidden), (hidden,), (hidden, hidden), (hidden,), (hidden, 1), (1,)):
        size = math.prod(shape)
        views.append(flat[at : at + size].reshape(shape))
        at += size
    w1, b1, w2, b2, w3, b3 = views
    return w1, b1, w2, b2, w3, b3


def train(
    features: FloatArray, labels: FloatArray, options: TrainingOptions, rng: np.random.Generator
) -> HazardNetwork:
    """Return a network trained on labelled rows.

    Args:
        features: n × FEATURES.
        labels: n, 0 or 1.
        options: how to train.
        rng: draws the first weights and the order of the samples.
    """
    inputs, hidden = features.shape[1], options.hidden
    size = inputs * hidden + hidden + hidden * hidden + hidden + hidden + 1
    flat = (np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size))
    weights, gradient = _views(flat[0], inputs, hidden), _views(flat[1], inputs, hidden)
    for layer, fan_in in ((0, inputs), (2, hidden), (4, hidden)):
        # Uniform with He's variance 2/fan_in, which keeps the scale through rectified units.
        weights[layer][:] = math.sqrt(6.0 / fan_in) * (2.0 * rng.random(weights[layer].shape) - 1.0)
    per_epoch = -(-len(features) // options.batch)
    steps = per_epoch * options.epochs
    rates = np.array([0.5 * options.learning_rate * (1.0 + math.cos(math.pi * i / steps)) for i in range(steps)])
    for epoch in range(options.epochs):
        order = rng.permutation(len(features))
        _epoch(features, labels, order, options.batch, rates, epoch * per_epoch, weights, gradient, flat)
    return HazardNetwork(*(part.copy() for part in weights))
