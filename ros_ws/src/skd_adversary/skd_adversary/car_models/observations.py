"""What a log of a black box says, tick by tick: what the car could see, and how its speed changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.world.state import BoolArray, FloatArray, IntArray

_ASIDE = 0.3  # m


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """One recorded episode, whatever it was recorded from.

    Attributes:
        adversary: n × 2 positions at ticks 0 … n − 1, world frame, m.
        car: n × 4: reference point (x, y), m, heading, rad, and speed, m/s; the lane leads North.
        time_step: duration of a tick, s.
        front: front bumper ahead of the reference point, m.
        rear: rear bumper behind it, m.
    """

    adversary: FloatArray
    car: FloatArray
    time_step: float
    front: float
    rear: float


@dataclass(frozen=True, eq=False)
class Observations:
    """One row per tick of every episode, in their order; all arrays have length n.

    Attributes:
        episode: index of the episode.
        tick: number of the tick within its episode.
        gap: front bumper to the adversary's centre along the lane, m.
        lateral: the adversary right of the car's centre line, m.
        receding: the adversary's velocity along the lane, m/s; 0 at tick 0, as the world has it.
        sideways: the adversary's velocity across the lane, m/s; 0 at tick 0.
        speed: speed of the car at the tick, m/s.
        speed_after: speed of the car one tick later, m/s.
        walking_away: the adversary's velocity along the lane in the tick itself, m/s.
        walking_sideways: the adversary's velocity across the lane in the tick itself, m/s.
        travelled: distance that the car drove in the tick, m.
        offset: the car right of the middle of its lane, m.
        drift: by how much that changes in the tick, m.
        turned: heading of the car after the tick, rad to the right of its lane.
        time_step: duration of a tick, s.
        front: front bumper ahead of the car's reference point, m.
        rear: rear bumper behind it, m.
    """

    episode: IntArray
    tick: IntArray
    gap: FloatArray
    lateral: FloatArray
    receding: FloatArray
    sideways: FloatArray
    speed: FloatArray
    speed_after: FloatArray
    walking_away: FloatArray
    walking_sideways: FloatArray
    travelled: FloatArray
    offset: FloatArray
    drift: FloatArray
    turned: FloatArray
    time_step: float
    front: float
    rear: float

    def __len__(self) -> int:
        return int(self.gap.size)

    @property
    def car_length(self) -> float:
        """From bumper to bumper, m."""
        return self.front + self.rear

    @property
    def evades(self) -> bool:
        """Whether the car goes so far aside that it matters where it is hit."""
        return bool((np.abs(self.offset + self.drift) > _ASIDE).any())

    @property
    def in_lane(self) -> Observations:
        """The same of a car of which only the road user's place beside it is looked at."""
        nothing = np.zeros(len(self))
        return replace(self, offset=nothing, drift=nothing, turned=nothing)

    @property
    def episodes(self) -> int:
        """Number of episodes with at least one tick."""
        return int(np.unique(self.episode).size)

    def of(self, rows: BoolArray) -> Observations:
        """Return the chosen rows; whole episodes, where a delay is to be looked back over."""
        columns: dict[str, Any] = {name: one[rows] for name, one in vars(self).items() if isinstance(one, np.ndarray)}
        return replace(self, **columns)


def observe(recordings: Sequence[RecordedEpisode]) -> Observations:
    """Return the ticks of recorded episodes.

    Raises:
        UsageError: none has a tick, their time steps or cars differ, or a state is not finite.
    """
    usable = [recording for recording in recordings if len(recording.car) >= 2]
    if not usable:
        raise UsageError("the logs hold no episode with a tick; record some with skd probe")
    first = usable[0]
    for index, recording in enumerate(usable):
        for name, unit in (("time_step", "s"), ("front", "m"), ("rear", "m")):
            one, other = getattr(first, name), getattr(recording, name)
            if one != other:
                raise UsageError(f"the logs differ in {name}: {one:g} {unit} and {other:g} {unit}; fit them apart")
        adversary, car = recording.adversary, recording.car
        if adversary.shape != (len(car), 2) or car.shape[1] != 4:
            raise UsageError(f"log {index}: {len(car)} states of the car and {len(adversary)} of the adversary")
        if not (np.isfinite(adversary).all() and np.isfinite(car).all()):
            raise UsageError(f"log {index}: a state is not finite")
    episodes = [_columns(index, recording) for index, recording in enumerate(usable)]
    columns: dict[str, Any] = {name: np.concatenate([one[name] for one in episodes]) for name in episodes[0]}
    return Observations(**columns, time_step=first.time_step, front=first.front, rear=first.rear)


def _columns(episode: int, recording: RecordedEpisode) -> dict[str, FloatArray | IntArray]:
    """Return the columns of `Observations` for one episode."""
    adversary, car = recording.adversary, recording.car
    walking = np.diff(adversary, axis=0) / recording.time_step
    before = np.vstack([np.zeros((1, 2)), walking[:-1]])
    return {
        "episode": np.full(len(walking), episode),
        "tick": np.arange(len(walking)),
        "gap": adversary[:-1, 1] - car[:-1, 1] - recording.front,
        "lateral": adversary[:-1, 0] - car[:-1, 0],
        "receding": before[:, 1],
        "sideways": before[:, 0],
        "speed": car[:-1, 3],
        "speed_after": car[1:, 3],
        "walking_away": walking[:, 1],
        "walking_sideways": walking[:, 0],
        "travelled": np.diff(car[:, 1]),
        "offset": car[:-1, 0],
        "drift": np.diff(car[:, 0]),
        "turned": HEADING_NORTH - car[1:, 2],
    }
