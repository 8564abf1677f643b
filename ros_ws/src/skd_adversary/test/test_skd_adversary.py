"""The package as installed. For `colcon test`."""

from __future__ import annotations

from importlib.metadata import entry_points


def test_it_plans_when_it_is_installed():
    """Its node is there, and the module behind it is the package's own."""
    (node,) = entry_points(group="console_scripts", name="adversary")
    assert node.value.startswith("skd_adversary.")
