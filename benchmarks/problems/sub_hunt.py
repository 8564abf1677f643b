"""SubHunt of `examples/sub_hunt` (Sunberg and Kochenderfer 2018), also with the fully observed value at its leaves.

Rules of `zsunberg/SubHunt.jl`, as POMCPOW's experiments used it. Two submarines on 20 × 20 cells, 1 … 20. The target
starts anywhere along one edge and makes for the opposite one: two cells ahead with probability 1/2, else one ahead and
one to the left or the right. Ours starts at (10, 10) and goes three cells North, East, South or West, or pings, or
engages. To engage within 2 cells of the target kills it, with probability 0.6 only if it is aware of us; a ping makes
it so for good. A kill is worth 100, all else nothing. γ = 0.99.

Eight beams of 45° each give a range. Passive sonar (with all but the ping) says N(3, 5²) in every beam, but
N(distance, 0.5²) in the target's within 3 cells; the ping says N(20, 0.5²), and N(distance, 0.5²) in the target's. The
episode ends with a kill, or when the target has reached its edge.
"""

from __future__ import annotations

import functools
import sys
from importlib import import_module
from pathlib import Path
from typing import Final

from observed_values import with_observed_leaves
from skd_adversary.pomdp.model import Pomdp

NORTH, EAST, SOUTH, WEST, PING, ENGAGE = range(6)
STATES: Final = ((1, 20), (1, 20), (1, 20), (1, 20), (0, 3), (0, 1))
"""Lowest and highest value of each number of a state."""
_EXAMPLE: Final = Path(__file__).resolve().parents[2] / "examples" / "sub_hunt"


@functools.cache
def sub_hunt() -> Pomdp:
    """Return SubHunt."""
    if str(_EXAMPLE) not in sys.path:
        sys.path.append(str(_EXAMPLE))
    model: Pomdp = import_module("sub_hunt").model
    return model


@functools.cache
def sub_hunt_with_leaves() -> Pomdp:
    """Return SubHunt with the value of the fully observed problem at its leaves."""
    return with_observed_leaves(sub_hunt(), STATES)
