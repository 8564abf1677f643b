"""Headings that come through a quaternion unchanged.

A message carries sin and cos of half a heading, from which it comes back with the error of four roundings. Headings of
a grid of π/2⁴⁰ (3·10⁻¹² rad), far coarser than that, are found again to the last bit; North, π/2, is one of them.
"""

from __future__ import annotations

import math

import numpy as np

from skd_sim.kernels.compilation import kernel

_GRAIN = math.pi / 2**40
_HALF_TURN = 2.0**40  # grains


@kernel
def on_grid(heading: float) -> float:
    """Return the heading of the grid that is nearest (rad), in (−π, π]; nan of one that is not finite."""
    grains = np.floor(heading / _GRAIN + 0.5)  # not math.floor, which makes a whole number of what is none
    turns = np.ceil((grains - _HALF_TURN) / (2.0 * _HALF_TURN))
    return (grains - 2.0 * _HALF_TURN * turns) * _GRAIN  # type: ignore[no-any-return]


def heading_of(z: float, w: float) -> float:
    """Return the heading (rad) of a rotation about the vertical, given by the quaternion (0, 0, z, w)."""
    return float(on_grid(2.0 * math.atan2(z, w)))
