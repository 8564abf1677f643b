"""The world of the Safe-Kamikaze Distance: encounters, cars, simulators, episodes.

What stands in `__all__` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_sim.controllers.protocol import Controller as Controller
    from skd_sim.controllers.protocol import SensingController as SensingController
    from skd_sim.encounter.scenario import Scenario as Scenario
    from skd_sim.encounter.scenario import load_scenario as load_scenario
    from skd_sim.episode.episode import Episode as Episode
    from skd_sim.episode.episode import EpisodeLog as EpisodeLog
    from skd_sim.episode.episode import Mode as Mode
    from skd_sim.episode.episode import Outcome as Outcome
    from skd_sim.errors import UsageError as UsageError
    from skd_sim.geometry.trajectory import Trajectory as Trajectory
    from skd_sim.kernels.compilation import kernel as kernel
    from skd_sim.sensors.scan import Scan as Scan
    from skd_sim.simulation.framed_simulator import FramedSimulator as FramedSimulator
    from skd_sim.simulation.framed_simulator import FrameSource as FrameSource
    from skd_sim.simulation.simulator import Frame as Frame
    from skd_sim.simulation.simulator import Simulator as Simulator
    from skd_sim.simulation.simulator import WorldSimulator as WorldSimulator
    from skd_sim.state import AdversaryState as AdversaryState
    from skd_sim.state import CarState as CarState
    from skd_sim.state import RoadUserState as RoadUserState
    from skd_sim.state import Scene as Scene

__all__ = [
    "AdversaryState",
    "CarState",
    "Controller",
    "Episode",
    "EpisodeLog",
    "Frame",
    "FrameSource",
    "FramedSimulator",
    "Mode",
    "Outcome",
    "RoadUserState",
    "Scan",
    "Scenario",
    "Scene",
    "SensingController",
    "Simulator",
    "Trajectory",
    "UsageError",
    "WorldSimulator",
    "kernel",
    "load_scenario",
]

_WHERE = {
    "AdversaryState": "skd_sim.state",
    "CarState": "skd_sim.state",
    "Controller": "skd_sim.controllers.protocol",
    "Episode": "skd_sim.episode.episode",
    "EpisodeLog": "skd_sim.episode.episode",
    "Frame": "skd_sim.simulation.simulator",
    "FrameSource": "skd_sim.simulation.framed_simulator",
    "FramedSimulator": "skd_sim.simulation.framed_simulator",
    "Mode": "skd_sim.episode.episode",
    "Outcome": "skd_sim.episode.episode",
    "RoadUserState": "skd_sim.state",
    "Scan": "skd_sim.sensors.scan",
    "Scenario": "skd_sim.encounter.scenario",
    "Scene": "skd_sim.state",
    "SensingController": "skd_sim.controllers.protocol",
    "Simulator": "skd_sim.simulation.simulator",
    "Trajectory": "skd_sim.geometry.trajectory",
    "UsageError": "skd_sim.errors",
    "WorldSimulator": "skd_sim.simulation.simulator",
    "kernel": "skd_sim.kernels.compilation",
    "load_scenario": "skd_sim.encounter.scenario",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
