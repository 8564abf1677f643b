"""Build hook: puts rosless.pth at the root of site-packages, in an ordinary and in an editable installation alike."""

from __future__ import annotations

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class RoslessPathHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the one-line .pth file by which Python finds rosless where there is no rclpy."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the file to what the wheel holds."""
        key = "force_include_editable" if version == "editable" else "force_include"
        build_data.setdefault(key, {})["rosless/rosless.pth"] = "rosless.pth"
