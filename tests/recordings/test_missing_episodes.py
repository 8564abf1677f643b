"""What recordings that lack episodes are told, also when an episode's number is as great as can be."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from skd_evaluator.assessment.plan import Stage, episode_id
from skd_evaluator.bags.checks import missing_episodes

_numbered = st.sets(st.tuples(st.integers(0, 3), st.integers(0, 4)), max_size=8)


def _told(announced: list[int]) -> list[str]:
    return missing_episodes(announced, {}, requested=1, left_out=False)


@given(_numbered)
def test_runs_are_missing_where_a_full_campaign_would_have_them(runs: set[tuple[int, int]]) -> None:
    """Said just where the runs are not all that some campaign has, which deals them out in turns."""
    lines = _told([episode_id(Stage.NOMINAL, index, run) for index, run in runs])
    safe = max((index for index, _ in runs), default=-1) + 1
    dealt = {(number % safe, number // safe) for number in range(len(runs))} if safe else set()
    assert bool(lines) == (runs != dealt)
