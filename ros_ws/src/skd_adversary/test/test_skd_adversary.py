"""The package as installed: parameter file and node.

For `colcon test`, with the workspace built and ROS 2 sourced.
"""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from skd_sim.ros.installed_nodes import interrupt, parameters_of, shipped_parameters, topics_of

PACKAGE = "skd_adversary"
pytest_plugins = ["skd_sim.ros.installed_nodes"]


def test_node(watcher, start):
    """It has the parameters of its shipped file, described, and its topics; Ctrl-C ends it without a word."""
    name = "adversary"
    file, wanted = shipped_parameters(PACKAGE, name)
    process = start(name, "--params-file", str(file))
    values, descriptions = parameters_of(watcher, process, name)
    assert values == wanted
    assert [name for name in wanted if name != "use_sim_time" and not descriptions[name]] == []
    topics = ({"/adversary/velocity_command"}, {"/ego/odometry", "/skd/episode"})
    assert topics_of(watcher, name, topics) == topics
    assert interrupt(process) == (0, "")
