"""The package as installed: what its folders hold. For `colcon test`."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import yaml

PACKAGE = "skd_sim"


def test_scenarios_are_installed():
    """All can be read."""
    folder = Path(importlib.util.find_spec(PACKAGE).origin).parent / "scenarios"
    for name in ("crossing", "citr_crossing", "crossing_multi_body"):
        assert yaml.safe_load((folder / f"{name}.yaml").read_text(encoding="utf-8"))["name"] == name


def test_network_of_cal_is_installed():
    """Both its files."""
    folder = Path(importlib.util.find_spec(PACKAGE).origin).parent / "controllers"
    assert [path.stat().st_size > 0 for path in sorted(folder.glob("hazard_network.*"))] == [True, True]
