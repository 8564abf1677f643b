"""SubHunt of the docs: its rules are those of `tests/benchmarks/test_sub_hunt.py`, in fewer than 80 lines."""

from __future__ import annotations

from pathlib import Path

import pytest
import sub_hunt as example
from skd_adversary.pomdp.model import check_model
from skd_adversary.pomdp.planner import PlannerOptions


def test_it_is_short() -> None:
    code = Path(example.__file__).read_text(encoding="utf-8").split('"""', 2)[2].splitlines()
    assert len([line for line in code if line.strip() and not line.strip().startswith("#")]) < 80


def test_nothing_is_wrong_with_it() -> None:
    check_model(example.model)


def test_an_episode_of_it() -> None:
    """It is played to the end: a kill after 3 to 20 moves, or the target has crossed the bay."""
    options = PlannerOptions(simulations=300, depth=20, exploration=100.0, particles=500)
    value = example.episode(3, options)
    assert value == 0.0 or value in [pytest.approx(100.0 * 0.99**moves) for moves in range(20)]
