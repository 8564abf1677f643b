"""One person's way that was cut, shifted in time or moved by noise is no second person's."""

from __future__ import annotations

import numpy as np
import pytest
from skd_adversary.safe_trajectories.believable import check_once
from skd_sim.errors import UsageError


def walk(seed: int, step: float = 0.1, begin: float = 0.0, seconds: float = 6.0) -> np.ndarray:
    """Somebody who sways and changes pace, as a function of time: looked at every `step` s from `begin` on."""
    rng = np.random.default_rng(seed)
    pace, phase, side = 1.3 + 0.2 * rng.random(), 2 * np.pi * rng.random(3), rng.normal(0.0, 0.3)
    t = begin + step * np.arange(round((seconds - begin) / step))
    x = pace * t + 0.15 * np.sin(0.9 * t + phase[0])
    return np.column_stack([x, side + 0.08 * np.sin(2.0 * t + phase[1]) + 0.03 * np.sin(6.0 * t + phase[2])])


FIRST = walk(1)
ASIDE = np.array([0.0, 0.02])
NOISE = np.random.default_rng(9).normal(0.0, 0.001, FIRST.shape)


@pytest.mark.parametrize(
    "again",
    [
        FIRST[3:],
        FIRST[:-9],
        FIRST[5:-5],
        walk(1, begin=0.033),  # its rows are between those of the other
        walk(1, begin=0.05)[:-4],
        FIRST + NOISE,
    ],
    ids=["begins later", "ends sooner", "both", "between rows", "between and cut", "a millimetre of noise"],
)
@pytest.mark.parametrize("turned", [False, True])
def test_a_way_that_is_most_of_another_is_refused(again, turned):
    ways = [("a", FIRST), ("b", walk(2)), ("c", again)]
    with pytest.raises(UsageError, match=r"^[ac]: is within 1 cm of the way of [ac] all along, cut or shifted in time"):
        check_once(ways[::-1] if turned else ways)


def test_people_who_walk_alike_are_not_one():
    """Hundreds who sway, at like paces; one who walks at another pace where somebody walked; one half of a way."""
    check_once((str(seed), walk(seed)) for seed in range(200))
    check_once([("a", FIRST), ("slower", walk(1, step=0.09))])
    check_once([("a", FIRST), ("half", FIRST[: len(FIRST) // 2] + ASIDE)])
    check_once([("a", FIRST), ("beside", FIRST + ASIDE + NOISE)])
    stands = np.tile([1.0, 2.0], (50, 1)) + np.random.default_rng(3).normal(0.0, 0.001, (50, 2))
    check_once([("stands", stands), ("there, too", stands[1:])])  # nobody is told from others by standing


def test_drawn_ways_may_be_alike():
    """One who waits before going the same way is another case of a crossing."""
    check_once([("a", FIRST), ("waits less", FIRST[3:])], moved=False)
