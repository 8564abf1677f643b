"""The hazard network: a multilayer perceptron with two hidden layers, evaluated in numpy."""

from __future__ import annotations

import functools
from importlib import resources
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_ROWS_AT_ONCE = 512


class HazardNetwork(NamedTuple):
    """Weights; inputs and outputs by the convention `row @ weights + bias`."""

    w1: FloatArray
    b1: FloatArray
    w2: FloatArray
    b2: FloatArray
    w3: FloatArray
    b3: FloatArray

    def probability(self, features: FloatArray) -> FloatArray:
        """Return the probability of a hazard for each row of features (k × FEATURES).

        Sums instead of matrix products: their order, and with it the bits, do not depend on a BLAS or on k.
        """
        parts = [self._forward(features[at : at + _ROWS_AT_ONCE]) for at in range(0, len(features), _ROWS_AT_ONCE)]
        return np.concatenate(parts) if parts else np.empty(0)

    def _forward(self, features: FloatArray) -> FloatArray:
        hidden = np.maximum(0.0, (features[:, :, None] * self.w1).sum(axis=1) + self.b1)
        hidden = np.maximum(0.0, (hidden[:, :, None] * self.w2).sum(axis=1) + self.b2)
        logit = (hidden[:, :, None] * self.w3).sum(axis=1)[:, 0] + self.b3[0]
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * logit))  # the logistic function, and no overflow


def save_network(network: HazardNetwork, target: Path) -> None:
    """Write the weights; the file's bytes depend on nothing but them."""
    np.savez(target, **network._asdict())


def load_network(source: Path | BinaryIO) -> HazardNetwork:
    """Read what `save_network` wrote."""
    with np.load(source) as file:
        return HazardNetwork(*(file[name] for name in HazardNetwork._fields))


@functools.cache
def shipped_network() -> HazardNetwork:
    """Return the network that comes with the package; `hazard_network.json` beside it says how it was trained."""
    with (resources.files("skd_sim") / "hazard" / "hazard_network.npz").open("rb") as file:
        return load_network(file)  # type: ignore[arg-type]
