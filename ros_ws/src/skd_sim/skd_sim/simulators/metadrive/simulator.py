"""MetaDrive as a simulator of SKD. Imports MetaDrive when an episode begins, not before."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, Final

from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.metadrive.pedals import VERSION, require_metadrive
from skd_sim.simulators.simulator import Frame, FramedSimulator
from skd_sim.world.episode import EpisodeSpec


class MetaDriveSimulator(FramedSimulator):
    """One MetaDrive a process; see `Simulator`. The others of a scenario are bodies in it."""

    repeats_itself: Final = True
    """Whether the same commands lead to the same states: to a rounding of its numbers, which have 24 bits."""

    def __init__(self) -> None:
        """Look that MetaDrive is installed.

        Raises:
            UsageError: it is not; says how it is installed.
        """
        require_metadrive()

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Build what the episode needs, and place car and adversary.

        Raises:
            UsageError: the road has curves, or this process cannot have an engine.
        """
        self._metadrive = _frames(episode.scenario)
        super().__init__(self._metadrive)
        return super().reset(episode)

    @property
    def position_error(self) -> float:
        """Greatest distance in this episode between MetaDrive's place of the adversary and the commanded one, m."""
        return float(self._metadrive.position_error)

    def described(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return, as plain data, what MetaDrive makes of a scenario's car: what its pedals do, as measured."""
        from skd_sim.simulators.metadrive.stage import StageSpec, pedals_of, stage_for, step_of

        stage = stage_for(scenario, step_of(scenario))
        vehicle = StageSpec.of(scenario).vehicle
        return {
            "version": VERSION,
            "physics_step": stage.step,
            "mass": vehicle.mass,
            "wheel_friction": vehicle.friction,
            "limits": list(pedals_of(stage, scenario).limits),
            "pedals": pedals_of(stage, scenario).as_dict(),
        }


def _frames(scenario: Scenario) -> Any:
    """Return the frames of MetaDrive; its imports say hello on standard output, where results go."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    from skd_sim.simulators.metadrive.stage import MetaDriveFrames

    return MetaDriveFrames(scenario)
