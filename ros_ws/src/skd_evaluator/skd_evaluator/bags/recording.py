"""What the messages of one graph in a recording say, gathered by episode and by stamp."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from skd_sim.errors import UsageError
from skd_sim.ros.from_messages import from_stamp, message_to_episode, odometry_to_adversary, odometry_to_car
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome

from skd_evaluator.assessment.plan.plan import model_digest
from skd_evaluator.assessment.run.assembly import EpisodeKey, Result, Samples, aborted, result_from_message, stamps
from skd_evaluator.bags.acceptance import Damage
from skd_evaluator.bags.mcap_file import Received, shortened
from skd_evaluator.bags.types import types_in

EPISODE, RESULT = "/skd/episode", "/skd/episode_result"
CAR, ADVERSARY = "/ego/odometry", "/adversary/odometry"
_MOST_STATES = 1_000_000
"""That one recording may hold: of some fifty thousand episodes."""


class EpisodeName(NamedTuple):
    """Says which episode of a campaign it is, however often it was run.

    Kamikazes of different objectives have the same ids, and hence the same draws; other episodes plan nothing, and
    their objective is no part of the name. So have those by which a car is learned, with each of the models that are
    tried.
    """

    campaign: str
    episode_id: int
    objective: str
    model: str


def _name(campaign: str, number: int, mode: int, objective: str, model: str) -> EpisodeName:
    if mode != Mode.KAMIKAZE:
        return EpisodeName(campaign, number, "", "")
    return EpisodeName(campaign, number, objective, model_digest(number, model))


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode found in a bag: identity and log."""

    key: EpisodeKey
    log: EpisodeLog

    @property
    def name(self) -> EpisodeName:
        """Which episode of its campaign it is."""
        spec = self.log.episode
        return _name(self.key.campaign, self.key.episode_id, spec.mode, str(spec.objective), spec.car_model)


@dataclass
class Recording:
    """What the nodes of one graph sent, in whatever order it came.

    Attributes:
        samples: states by stamp.
        episodes: specifications, as messages.
        results: how they ended.
        disputed: episodes of which two different things were said, and what.
        torn: stamps (ns) at which there are two different states, and what is to be said of that.
    """

    samples: Samples = field(default_factory=Samples)
    episodes: dict[EpisodeKey, Any] = field(default_factory=dict)
    results: dict[EpisodeKey, Result] = field(default_factory=dict)
    disputed: dict[EpisodeKey, str] = field(default_factory=dict)
    torn: dict[int, str] = field(default_factory=dict)
    _said: dict[tuple[str, EpisodeKey], bytes] = field(default_factory=dict)

    def announced(self) -> Iterator[EpisodeName]:
        """Yield the name of every episode that was announced, however it ended."""
        for key, message in self.episodes.items():
            yield _name(key.campaign, key.episode_id, int(message.mode), str(message.objective), str(message.car_model))

    def add(self, role: str, content: Any, message: Received) -> None:
        """Take a message.

        Args:
            role: what the topic is for: its name without a namespace.
            content: the message, decoded.
            message: the message as it was recorded.

        Raises:
            UsageError: there are too many states.
        """
        if role == EPISODE:
            key = EpisodeKey(content.campaign, int(content.episode_id), from_stamp(content.header.stamp))
            if self._agrees(role, key, content, message):
                self.episodes[key] = content
        elif role == RESULT:
            key = EpisodeKey(content.campaign, int(content.episode_id), from_stamp(content.start))
            if self._agrees(role, key, content, message):
                self.results[key] = result_from_message(content)
        else:
            self._add_state(role, content)

    def _agrees(self, role: str, key: EpisodeKey, content: Any, message: Received) -> bool:
        """Whether all messages about the episode on this topic say the same, paddings between fields apart."""
        known, said = self._said.setdefault((role, key), message.data), message.data
        if known == said:
            return True
        schema = message.schema
        store, name = types_in(schema.name, schema.encoding, schema.data), schema.name
        if store.serialize_cdr(store.deserialize_cdr(known, name), name) == store.serialize_cdr(content, name):
            return True
        self.disputed[key] = f"two different messages on {role} are about it: who sent them?"
        return False

    def _add_state(self, role: str, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        try:
            if role == CAR:
                car = odometry_to_car(message)
                self.samples.add_car(stamp, car.x, car.y, car.speed)
            else:
                adversary = odometry_to_adversary(message)
                self.samples.add_adversary(stamp, adversary.x, adversary.y)
        except UsageError as error:
            self.torn[stamp] = str(error)
        if len(self.samples) > _MOST_STATES:
            raise UsageError(f"holds more than {_MOST_STATES} states; split it (ros2 bag record --max-bag-duration)")

    def logs(self, where: str, damage: Damage) -> Iterator[RecordedEpisode]:
        """Yield the episodes that ended and are complete, as the messages describe them.

        Args:
            where: name of the recording, for error lines.
            damage: told of episodes that are not yielded.
        """
        for key, result in self.results.items():
            name = f"{where}: episode {key.episode_id}"
            if key not in self.episodes:
                damage.leave_out(
                    f"{where}: has the result of episode {key.episode_id} but not the episode: record {EPISODE}"
                )
                continue
            if key in self.disputed:
                damage.leave_out(f"{name}: {self.disputed[key]}")
                continue
            try:
                episode = message_to_episode(self.episodes[key])
            except ValueError as error:
                damage.leave_out(f"{name} is not valid ({shortened(str(error))})")
                continue
            log = self._log(episode, key, result, where, damage)
            if log is not None:
                yield RecordedEpisode(key, log)

    def _log(self, episode: Episode, key: EpisodeKey, result: Result, where: str, damage: Damage) -> EpisodeLog | None:
        name = f"{where}: episode {key.episode_id}"
        if result.ticks > episode.scenario.ticks:
            damage.leave_out(
                f"{name}: is said to have {result.ticks} ticks, its scenario at most {episode.scenario.ticks}"
            )
            return None
        torn = next((stamp for stamp in stamps(episode, key.start, result) if stamp in self.torn), None)
        if torn is not None:
            damage.leave_out(f"{name}: {self.torn[torn]}")
            return None
        missing = self.samples.missing(episode, key.start, result)
        if not missing:
            return self.samples.log(episode, key.start, result)
        if result.outcome == Outcome.ABORTED:
            return aborted(episode, result.reason)
        damage.leave_out(
            f"{where}: {missing} states of episode {key.episode_id} are missing: was recording begun too late, "
            f"or were {CAR} and {ADVERSARY} not recorded?"
        )
        return None
