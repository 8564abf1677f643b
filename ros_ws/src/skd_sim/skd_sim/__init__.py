"""The world of the Safe-Kamikaze Distance: scenarios, cars, simulators, episodes.

What stands in `__all__` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_sim.controllers.protocol import Controller as Controller
    from skd_sim.controllers.protocol import SensingController as SensingController
    from skd_sim.errors import UsageError as UsageError
    from skd_sim.kernels.compilation import kernel as kernel
    from skd_sim.scenario.scenario import Scenario as Scenario
    from skd_sim.scenario.scenario import load_scenario as load_scenario
    from skd_sim.simulators.framed_simulator import FramedSimulator as FramedSimulator
    from skd_sim.simulators.framed_simulator import FrameSource as FrameSource
    from skd_sim.simulators.simulator import Frame as Frame
    from skd_sim.simulators.simulator import Simulator as Simulator
    from skd_sim.simulators.simulator import WorldSimulator as WorldSimulator
    from skd_sim.world.episode import EpisodeLog as EpisodeLog
    from skd_sim.world.episode import EpisodeSpec as EpisodeSpec
    from skd_sim.world.episode import Mode as Mode
    from skd_sim.world.episode import Outcome as Outcome
    from skd_sim.world.sensors import Scan as Scan
    from skd_sim.world.state import AdversaryState as AdversaryState
    from skd_sim.world.state import CarState as CarState
    from skd_sim.world.state import RoadUserState as RoadUserState
    from skd_sim.world.state import Scene as Scene
    from skd_sim.world.state import Trajectory as Trajectory

_WHERE = {
    "AdversaryState": "skd_sim.world.state",
    "CarState": "skd_sim.world.state",
    "Controller": "skd_sim.controllers.protocol",
    "EpisodeSpec": "skd_sim.world.episode",
    "EpisodeLog": "skd_sim.world.episode",
    "Frame": "skd_sim.simulators.simulator",
    "FrameSource": "skd_sim.simulators.framed_simulator",
    "FramedSimulator": "skd_sim.simulators.framed_simulator",
    "Mode": "skd_sim.world.episode",
    "Outcome": "skd_sim.world.episode",
    "RoadUserState": "skd_sim.world.state",
    "Scan": "skd_sim.world.sensors",
    "Scenario": "skd_sim.scenario.scenario",
    "Scene": "skd_sim.world.state",
    "SensingController": "skd_sim.controllers.protocol",
    "Simulator": "skd_sim.simulators.simulator",
    "Trajectory": "skd_sim.world.state",
    "UsageError": "skd_sim.errors",
    "WorldSimulator": "skd_sim.simulators.simulator",
    "kernel": "skd_sim.kernels.compilation",
    "load_scenario": "skd_sim.scenario.scenario",
}
__all__ = sorted(_WHERE)
__getattr__, __dir__ = exported(__name__, _WHERE)
