"""How alike two worlds put cars in order: Kendall's τ of a figure, with two intervals.

τ-b (Kendall 1945) over pairs of cars: 1 where both worlds order every pair alike, −1 where they order each the other
way round; a pair that one of them calls equal counts for neither. Two things are uncertain. What a car's figure is in a
world rests on the φ that it was asked about: the first interval draws φ anew, the same ones for all cars and worlds.
And which cars are compared is a choice: the second draws cars anew; a car beside itself is no pair. Both are the
percentiles of a bootstrap, and neither knows of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

RESAMPLES = 4000
Floats = npt.NDArray[np.float64]
Groups = Sequence[npt.ArrayLike]
"""Of each φ, the values of its trials."""


class Agreement(NamedTuple):
    """How alike two worlds put cars in order.

    Attributes:
        cars: how many have a figure in both worlds.
        tau: Kendall's τ-b; nan where a world calls all of them equal.
        by_phi: 95 % interval over φ; None with one φ.
        by_cars: 95 % interval over cars; None below three cars.
    """

    cars: int
    tau: float
    by_phi: tuple[float, float] | None
    by_cars: tuple[float, float] | None


def kendall_tau(first: npt.ArrayLike, second: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> Floats:
    """Return Kendall's τ-b of two rows of figures, or of many pairs of rows at once.

    Args:
        first: figures of the cars in one world, … × cars.
        second: those of the same cars in the other, in the same shape.
        weights: how often each car counts, … × cars; a car is never compared with itself.
    """
    one, other = (np.asarray(figures, dtype=np.float64) for figures in (first, second))
    weight = np.ones(one.shape) if weights is None else np.asarray(weights, dtype=np.float64)
    left, right = np.triu_indices(one.shape[-1], k=1)
    signs = [np.sign(row[..., left] - row[..., right]) for row in (one, other)]
    pairs = weight[..., left] * weight[..., right]
    agree = (pairs * signs[0] * signs[1]).sum(axis=-1)
    told = [(pairs * np.abs(sign)).sum(axis=-1) for sign in signs]
    with np.errstate(invalid="ignore"):
        return np.asarray(agree / np.sqrt(told[0] * told[1]))


def agreement(first: Sequence[Groups], second: Sequence[Groups], seed: int = 0) -> Agreement:
    """Return how alike two worlds order cars by the means of a figure.

    Args:
        first: for each car, for each φ, the figure's values in one world; nan says nothing.
        second: the same of the other world, cars and φ in the same order.
        seed: of the resamples.

    Raises:
        ValueError: the two are not of equally many cars and φ.
    """
    shapes = {len(car) for car in (*first, *second)}
    if len(first) != len(second) or len(shapes) > 1:
        raise ValueError("both worlds must have the same cars and φ")
    sums = [[_sums(car) for car in world] for world in (first, second)]
    known = [k for k in range(len(first)) if all(world[k][1].sum() for world in sums)]
    if len(known) < 2:
        return Agreement(len(known), float("nan"), None, None)
    totals, counts = (np.array([[world[k][part] for k in known] for world in sums]) for part in (0, 1))
    means = totals.sum(axis=-1) / counts.sum(axis=-1)  # world × car
    rng, phis = np.random.default_rng(seed), totals.shape[-1]
    by_phi = by_cars = None
    if phis > 1:
        drawn = rng.multinomial(phis, np.full(phis, 1.0 / phis), RESAMPLES).astype(np.float64)
        with np.errstate(invalid="ignore"):
            again = np.einsum("wcp,rp->wrc", totals, drawn) / np.einsum("wcp,rp->wrc", counts, drawn)
        by_phi = _percentiles(kendall_tau(again[0], again[1]))
    if len(known) > 2:
        cars = len(known)
        often = rng.multinomial(cars, np.full(cars, 1.0 / cars), RESAMPLES)
        by_cars = _percentiles(kendall_tau(*(np.broadcast_to(world, often.shape) for world in means), often))
    return Agreement(len(known), float(kendall_tau(means[0], means[1])), by_phi, by_cars)


def _sums(groups: Groups) -> tuple[Floats, Floats]:
    """Return sum and number of the values of each φ that say something."""
    arrays = [np.asarray(group, dtype=np.float64) for group in groups]
    said = [group[~np.isnan(group)] for group in arrays]
    return np.array([group.sum() for group in said]), np.array([float(group.size) for group in said])


def _percentiles(values: Floats) -> tuple[float, float] | None:
    told = values[~np.isnan(values)]
    if not told.size:
        return None
    low, high = np.quantile(told, (0.025, 0.975))
    return float(low), float(high)
