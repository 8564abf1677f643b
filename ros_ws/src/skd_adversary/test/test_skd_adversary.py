"""The package as installed. For `colcon test`; its node is tested with the others, in skd_evaluator."""

from skd_adversary.adversary import warm_up_episodes


def test_an_episode_can_be_planned():
    """Of each objective by its name."""
    assert all(list(warm_up_episodes(objective=name)) for name in ("paper", "deviation"))
