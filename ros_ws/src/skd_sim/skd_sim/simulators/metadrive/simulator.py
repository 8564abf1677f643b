"""MetaDrive as a simulator, and its own driver as a car under test. Imports it when an episode begins, not before.

The driver is a policy that MetaDrive's makers have trained by reinforcement learning
(`metadrive/examples/ppo_expert`, Apache-2.0; Li et al., IEEE T-PAMI 45, 2023): a network of two hidden layers of 256,
its weights in the wheel of MetaDrive. It steers as well as it brakes. It sees through MetaDrive's lidar, so it decides
in the MetaDrive that simulates and nowhere else: from the states of another world it would see a world that has just
begun.
"""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.metadrive.pedals import METADRIVE, VERSION, require_metadrive
from skd_sim.simulators.simulator import Frame, FramedSimulator
from skd_sim.world.episode import EpisodeSpec
from skd_sim.world.state import AdversaryState, CarState


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
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # else its imports say hello where results go
        from skd_sim.simulators.metadrive.stage import MetaDriveFrames

        self._metadrive = MetaDriveFrames(episode.scenario)
        super().__init__(self._metadrive)
        return super().reset(episode)

    @property
    def position_error(self) -> float:
        """Greatest distance in this episode between MetaDrive's place of the adversary and the commanded one, m."""
        return float(self._metadrive.position_error)

    def described(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return, as plain data, what MetaDrive makes of a scenario's car: what its pedals do, as measured."""
        from skd_sim.simulators.metadrive.stage import StageSpec, pedals_of, stage_for

        stage = stage_for(scenario)
        vehicle = StageSpec.of(scenario).vehicle
        return {
            "version": VERSION,
            "physics_step": stage.step,
            "mass": vehicle.mass,
            "wheel_friction": vehicle.friction,
            "limits": list(pedals_of(stage, scenario).limits),
            "pedals": pedals_of(stage, scenario).as_dict(),
        }


CONTROL_PERIOD: Final = 0.1
"""Time between two of its decisions, s: five steps of MetaDrive's physics, as in its training."""
_LAYERS: Final = ("fc_1", "fc_2", "fc_out")
_MIRRORED: Final = (10, 15)  # of the observation: MetaDrive turned its axes after the training (`obs_correction`)

Floats = npt.NDArray[np.float32]


@functools.cache
def expert_weights() -> tuple[tuple[Floats, Floats], ...]:
    """Return the weights of the network's layers, as MetaDrive's wheel has them.

    Raises:
        UsageError: MetaDrive is not installed.
    """
    require_metadrive()
    found = importlib.util.find_spec(METADRIVE)  # which imports nothing
    folders = [] if found is None else list(found.submodule_search_locations or ())
    file = Path(folders[0]) / "examples" / "ppo_expert" / "expert_weights.npz"
    with np.load(file, allow_pickle=False) as arrays:
        return tuple(
            (arrays[f"default_policy/{layer}/kernel"], arrays[f"default_policy/{layer}/bias"]) for layer in _LAYERS
        )


def distribution(observation: Floats) -> tuple[Floats, Floats]:
    """Return means and standard deviations from which the expert draws steering and pedal, before both are clipped.

    Args:
        observation: what MetaDrive's `LidarStateObservation` says of its car, of 275.
    """
    seen = observation.copy()
    for index in _MIRRORED:
        seen[index] = 1.0 - seen[index]
    layer = seen.reshape(1, -1)
    *hidden, (kernel, bias) = expert_weights()
    for weights, offset in hidden:
        layer = np.tanh(np.matmul(layer, weights) + offset)
    mean, log_deviation = np.split((np.matmul(layer, kernel) + bias).reshape(-1), 2)
    return mean, np.exp(log_deviation)


class MetaDriveExpert:
    """MetaDrive's expert; its decisions are drawn from its own generator, as MetaDrive draws them."""

    control_period: Final = CONTROL_PERIOD
    """Time between two decisions, s."""

    def __init__(self) -> None:
        """Look that MetaDrive is installed.

        Raises:
            UsageError: it is not; says how it is installed.
        """
        require_metadrive()
        self._observation: Any = None

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take its place in the MetaDrive that simulates.

        Raises:
            UsageError: none does in this process.
        """
        from skd_sim.simulators.metadrive.stage import pedals_of, running

        stage = running()
        if stage is None or stage.cast is None or not stage.cast.fits(scenario):
            raise UsageError(
                "controller metadrive_expert decides within the MetaDrive that simulates: use it with --simulator "
                f"{METADRIVE}, in process"
            )
        from metadrive.obs.state_obs import LidarStateObservation

        self._stage, self._rng = stage, rng
        self._pedals = pedals_of(stage, scenario)
        self._observation = LidarStateObservation(stage.engine.global_config)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Decide, leave steering and pedal with MetaDrive, and return the acceleration (m/s²) that the pedal means."""
        from skd_sim.simulators.metadrive.stage import Decided

        self._stage.car.after_step()  # brings what its observation is made of up to date
        mean, deviation = distribution(self._observation.observe(self._stage.car))
        steering, pedal = np.clip(self._rng.normal(mean, deviation), -1.0, 1.0).tolist()
        acceleration = self._pedals.acceleration(pedal)
        self._stage.decided = Decided(steering, pedal, acceleration)
        return acceleration
