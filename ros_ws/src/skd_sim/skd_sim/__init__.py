"""The world of the Safe-Kamikaze Distance: scenarios, cars, simulators, episodes.

What stands in `__init__.pyi` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from skd_sim.public import exported

__all__, __getattr__, __dir__ = exported(__name__, __file__)
