"""Simulators by name: an episode says which one it runs in. Light: every command begins with it."""

from __future__ import annotations

from typing import Final

from skd_sim.options.registry import Registry

WORLD: Final = "world"
SIMULATORS: Final = Registry(
    "simulator",
    "skd.simulators",
    {
        WORLD: "skd_sim.world.simulator:WorldSimulator",
        "metadrive": "skd_sim.simulators.metadrive.simulator:MetaDriveSimulator",
    },
)
"""Classes of `skd_sim.world.simulator.Simulator`, made without arguments."""


def is_own_world(name: str) -> bool:
    """Return whether a simulator is SKD's own, for which it is known what other commands would have led to."""
    return name == WORLD
