"""From stamped samples to episode logs: the same code for a live graph and for bags."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.world.episode import UNTIMED, EpisodeLog, EpisodeSpec, Outcome, Timing, tick_stamp
from skd_sim.world.state import AdversaryState, CarState, FloatArray


class EpisodeKey(NamedTuple):
    """Identity of an episode on the wire: campaign, id, and stamp of its tick 0 (ns)."""

    campaign: str
    episode_id: int
    start: int


@dataclass(frozen=True)
class EpisodeEnd:
    """How an episode ended, as the simulator says: see skd_msgs/EpisodeResult."""

    outcome: Outcome
    ticks: int
    impact_time: float
    impact_speed: float
    reason: str
    clipped: int = 0
    timing: Timing = UNTIMED
    commands: FloatArray | None = None


class Samples:
    """States by stamp (ns), in whatever order they come."""

    def __init__(self) -> None:
        """Start empty."""
        self.car: dict[int, CarState] = {}
        self.adversary: dict[int, tuple[float, float]] = {}

    def add(self, stamp: int, state: CarState | AdversaryState) -> None:
        """Add a state of the car, or of the adversary, of which the place is kept.

        Raises:
            UsageError: another one has the same stamp.
        """
        if isinstance(state, CarState):
            same, whose = self.car.setdefault(stamp, state) == state, "car"
        else:
            place = state.x, state.y
            same, whose = self.adversary.setdefault(stamp, place) == place, "adversary"
        if not same:
            when = f"simulation time {stamp / 1e9:.3f} s"
            raise UsageError(f"two different states of the {whose} at {when}: several recordings are mixed")

    def __len__(self) -> int:
        """Return how many states have come."""
        return len(self.car) + len(self.adversary)

    def missing(self, episode: EpisodeSpec, start: int, result: EpisodeEnd) -> int:
        """Return how many states of an episode have not come yet."""
        needed = stamps(episode, start, result)
        return sum((stamp not in self.car) + (stamp not in self.adversary) for stamp in needed)

    def log(self, episode: EpisodeSpec, start: int, result: EpisodeEnd) -> EpisodeLog:
        """Return the log of an episode that started at `start` (ns); its states must all have come."""
        needed = stamps(episode, start, result)
        adversary, car = (np.array([states[stamp] for stamp in needed]) for states in (self.adversary, self.car))
        said = {name: value for name, value in vars(result).items() if name != "ticks"}
        return EpisodeLog(episode, adversary=adversary, car=car, **said)

    def clear(self) -> None:
        """Forget everything."""
        self.car.clear()
        self.adversary.clear()


def result_from_message(message: Any) -> EpisodeEnd:
    """Return the result that an EpisodeResult message holds."""
    ages = tuple(float(age) for age in message.command_ages)
    timing = Timing(ages, int(message.commands_held), float(message.greatest_delay))
    return EpisodeEnd(
        Outcome(int(message.outcome)),
        int(message.ticks),
        float(message.impact_time),
        float(message.impact_speed),
        str(message.reason),
        int(message.commands_clipped),
        timing,
        np.array([(one.linear.x, one.angular.z) for one in message.commands]).reshape(-1, 2),
    )


def aborted(episode: EpisodeSpec, reason: str) -> EpisodeLog:
    """Return the log of an episode that could not be finished."""
    start, nowhere = np.array([episode.start]), np.full((1, 4), math.nan)
    return EpisodeLog(episode, Outcome.ABORTED, start, nowhere, reason=reason)


def stamps(episode: EpisodeSpec, start: int, result: EpisodeEnd) -> list[int]:
    """Return the stamps (ns) of an episode's ticks."""
    return [tick_stamp(start, tick, episode.scenario.time_step) for tick in range(result.ticks + 1)]
