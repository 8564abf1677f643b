"""Particle belief: a weighted sample of states, updated by importance weighting (bootstrap filter).

Systematic resampling when the effective sample size falls below half of the particles (Kong, Liu and Wong 1994;
Kitagawa 1996). When no particle explains the observation any more (all weights zero, or every particle predicts that
the episode has ended), the particles are redrawn by the model's `reinvigorate` and the event is counted.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from skd_sim.kernels.compilation import bound, kernel, template, unbound
from skd_sim.kernels.stream import stream_of
from skd_sim.world.state import FloatArray, Pair

from skd_adversary.pomdp.model import Pomdp
from skd_adversary.pomdp.tree import IndexArray

RESAMPLE_BELOW = 0.5
"""Resample when the effective sample size is below this share of the particles."""


_initial = _step = _likelihood = _reinvigorate = unbound


@template(inline=False, allocates=False)
def _draw(parameters: Any, particles: FloatArray, rng: np.random.Generator) -> None:
    for i in range(particles.shape[0]):
        _initial(parameters, particles[i], rng)


@template(inline=False, allocates=False)
def _propagate(
    parameters: Any,
    particles: FloatArray,
    weights: FloatArray,
    action: int,
    moved: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Move every particle; one that ends the episode gets weight 0, for the episode goes on."""
    for i in range(particles.shape[0]):
        _, terminal = _step(parameters, particles[i], action, moved[i], rng)
        if terminal:
            weights[i] = 0.0


@template(inline=False, allocates=False)
def _reweigh(
    parameters: Any, particles: FloatArray, weights: FloatArray, action: int, observation: FloatArray
) -> float:
    """Multiply the weights by the likelihoods, normalise them, and return their sum before that."""
    total = 0.0
    for i in range(particles.shape[0]):
        if weights[i] > 0.0:
            weights[i] *= _likelihood(parameters, particles[i], action, observation)
        total += weights[i]
    if total > 0.0 and np.isfinite(total):
        for i in range(weights.shape[0]):
            weights[i] /= total
        return total
    return 0.0


@template(inline=False, allocates=False)
def _redraw(
    parameters: Any, particles: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    for i in range(particles.shape[0]):
        _reinvigorate(parameters, particles[i], observation, redrawn[i], rng)


@kernel
def effective_sample_size(weights: FloatArray) -> float:
    """Return 1 / Σ w² of normalised weights: between 1 and their number (Kong, Liu and Wong 1994)."""
    return 1.0 / np.sum(weights * weights)


@kernel(allocates=False)
def draw_sources(weights: FloatArray, sources: IndexArray, rng: np.random.Generator) -> None:
    """Draw particles by their weights, systematically (Kitagawa 1996): each gets the share that is its due."""
    count = sources.shape[0]
    offset = rng.random()
    cumulative = weights[0]
    source = 0
    for i in range(count):
        position = (i + offset) / count
        while cumulative < position and source < weights.shape[0] - 1:
            source += 1
            cumulative += weights[source]
        sources[i] = source


@kernel
def moments(particles: FloatArray, weights: FloatArray, column: int) -> Pair:
    """Return the mean of one number of the state and its standard deviation, by normalised weights."""
    mean = 0.0
    for i in range(particles.shape[0]):
        mean += weights[i] * particles[i, column]
    square = 0.0
    for i in range(particles.shape[0]):
        square += weights[i] * (particles[i, column] - mean) ** 2
    return mean, np.sqrt(square)


@functools.cache
def _kernels(name: str, *functions: Callable[..., Any]) -> tuple[Callable[..., Any], ...]:
    parts = dict(zip(("_initial", "_step", "_likelihood", "_reinvigorate"), functions, strict=True))
    return tuple(bound(one, name, parts) for one in (_draw, _propagate, _reweigh, _redraw))


class ParticleBelief:
    """What the adversary believes.

    Attributes:
        particles: n × state_dim array.
        weights: n normalised weights.
        depletions: how often no particle explained the observation.
    """

    def __init__(self, model: Pomdp, count: int, rng: np.random.Generator) -> None:
        """Draw `count` particles from the model's initial belief."""
        if count < 1:
            raise ValueError(f"a belief needs at least one particle, got {count}")
        self._model = model
        self._rng = stream_of(rng)
        self._draw, self._propagate, self._reweigh, self._redraw = _kernels(
            model.name, model.initial, model.step, model.likelihood, model.reinvigorate
        )
        self.particles = np.empty((count, model.state_dim))
        self._spare = np.empty_like(self.particles)
        self._sources = np.empty(count, np.uint32)
        self.weights = np.full(count, 1.0 / count)
        self.depletions = 0
        self._draw(model.parameters, self.particles, self._rng)

    @property
    def mean(self) -> FloatArray:
        """Weighted mean state."""
        mean: FloatArray = self.weights @ self.particles
        return mean

    def moments(self, column: int) -> Pair:
        """Return the mean of one number of the state and its standard deviation."""
        mean, deviation = moments(self.particles, self.weights, column)
        return mean, deviation

    def predict(self, action: int) -> None:
        """Move the belief through one step of the model."""
        self._propagate(self._model.parameters, self.particles, self.weights, action, self._spare, self._rng)
        self.particles, self._spare = self._spare, self.particles

    def correct(self, action: int, observation: FloatArray) -> None:
        """Condition on what was observed after `action`; resample or reinvigorate as the module describes."""
        parameters = self._model.parameters
        if self._reweigh(parameters, self.particles, self.weights, action, observation) == 0.0:
            self._redraw(parameters, self.particles, observation, self._spare, self._rng)
            self.depletions += 1
        elif effective_sample_size(self.weights) < RESAMPLE_BELOW * len(self.weights):
            draw_sources(self.weights, self._sources, self._rng)
            np.take(self.particles, self._sources, axis=0, out=self._spare, mode="clip")
        else:
            return
        self.particles, self._spare = self._spare, self.particles
        self.weights.fill(1.0 / len(self.weights))
