"""Reads episodes back from recordings, written by SKD or by `ros2 bag record`.

Nothing is assumed about the order of messages, how they are split over chunks and files, or what else was recorded; and
everything that can be recomputed is checked. The assessment of recorded episodes is computed by the same code as live.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import Objective
from skd_sim.options.options import PLANNING, options_of, shared_options
from skd_sim.ros.from_messages import from_stamp, message_to_episode, odometry_to_adversary, odometry_to_car
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment, KamikazeSet, assessment_of, in_order
from skd_evaluator.assessment.episode_figures import missed_periods, standing
from skd_evaluator.assessment.options import RECORDED
from skd_evaluator.assessment.plan import (
    TRIALS_PER_REQUESTED,
    EpisodeGroup,
    Plan,
    follows_other_trajectory,
    model_digest,
    split_episode_id,
)
from skd_evaluator.assessment.run.episodes import EpisodeEnd, EpisodeKey, Samples, aborted, result_from_message, stamps
from skd_evaluator.bags import checks
from skd_evaluator.bags.checks import Damage, LocatedLog, accept
from skd_evaluator.bags.files import find_recordings
from skd_evaluator.bags.messages import Received, read_messages, shortened, typestore
from skd_evaluator.metrics.aborted import aborted_lines

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


def name_of(one: LocatedLog) -> EpisodeName:
    """Return which episode of its campaign a recorded one is."""
    spec = one.log.episode
    return _name(one.campaign, spec.episode_id, spec.mode, str(spec.objective), spec.car_model)


@dataclass
class GraphRecording:
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
    results: dict[EpisodeKey, EpisodeEnd] = field(default_factory=dict)
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
        store, name = message.types, message.type
        if store.serialize_cdr(store.deserialize_cdr(known, name), name) == store.serialize_cdr(content, name):
            return True
        self.disputed[key] = f"two different messages on {role} are about it: who sent them?"
        return False

    def _add_state(self, role: str, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        try:
            self.samples.add(stamp, odometry_to_car(message) if role == CAR else odometry_to_adversary(message))
        except UsageError as error:
            self.torn[stamp] = str(error)
        if len(self.samples) > _MOST_STATES:
            raise UsageError(f"holds more than {_MOST_STATES} states; split it (ros2 bag record --max-bag-duration)")

    def logs(self, where: str, damage: Damage) -> Iterator[LocatedLog]:
        """Yield the episodes that ended and are complete, as the messages describe them.

        Args:
            where: name of the recording, for error lines.
            damage: takes note of episodes that are not yielded.
        """
        for key, result in self.results.items():
            episode = f"{where}: episode {key.episode_id}"
            try:
                if key not in self.episodes:
                    number = key.episode_id
                    raise ValueError(
                        f"{where}: has the result of episode {number} but not the episode: record {EPISODE}"
                    )
                if key in self.disputed:
                    raise ValueError(f"{episode}: {self.disputed[key]}")
                yield LocatedLog(self._log(key, result, where), where, key.campaign, key.start)
            except ValueError as error:
                damage.leave_out(str(error))

    def _log(self, key: EpisodeKey, result: EpisodeEnd, where: str) -> EpisodeLog:
        """Return an episode as it was recorded.

        Raises:
            ValueError: it is not valid, or is not there as a whole.
        """
        name = f"{where}: episode {key.episode_id}"
        try:
            episode = message_to_episode(self.episodes[key])
        except ValueError as error:
            raise ValueError(f"{name} is not valid ({shortened(str(error))})") from error
        most = episode.scenario.ticks
        if result.ticks > most:
            raise ValueError(f"{name}: is said to have {result.ticks} ticks, its scenario at most {most}")
        torn = next((stamp for stamp in stamps(episode, key.start, result) if stamp in self.torn), None)
        if torn is not None:
            raise ValueError(f"{name}: {self.torn[torn]}")
        missing = self.samples.missing(episode, key.start, result)
        if not missing:
            return self.samples.log(episode, key.start, result)
        if result.outcome == Outcome.ABORTED:
            return aborted(episode, result.reason)
        lacks = f"{missing} states of episode {key.episode_id} are missing"
        raise ValueError(f"{where}: {lacks}: were {CAR} and {ADVERSARY} recorded from its beginning on?")


_TOPICS = {
    CAR: "nav_msgs/msg/Odometry",
    ADVERSARY: "nav_msgs/msg/Odometry",
    EPISODE: "skd_msgs/msg/Episode",
    RESULT: "skd_msgs/msg/EpisodeResult",
}


@dataclass(frozen=True)
class BagContent:
    """What recordings hold.

    Attributes:
        episodes: the episodes that ended and count, each once, in the order of their names.
        unfinished: names of those that were announced and never ended, sorted.
        announced: names of all that were announced, whatever became of them.
        files: the files that were read.
    """

    episodes: list[LocatedLog]
    unfinished: list[EpisodeName]
    announced: set[EpisodeName]
    files: list[Path]


def read_bags(paths: Sequence[Path], damage: Damage | None = None) -> BagContent:
    """Return all episodes of recordings that can have happened.

    Args:
        paths: bag folders, files of recordings, or folders of them.
        damage: takes note of what is left out and what is to be said; by default whatever is damaged is refused.

    Raises:
        UsageError: a file cannot be read, or something is damaged and must not be left out.
    """
    damage = damage or Damage()
    found: dict[EpisodeName, list[LocatedLog]] = {}
    announced: set[EpisodeName] = set()
    recordings = find_recordings(paths, damage)
    for files in recordings:
        where, graphs = str(files[0]), dict[str, GraphRecording]()
        for file in files:
            _read_file(file, graphs, damage)
        for recording in graphs.values():
            announced.update(recording.announced())
            for episode in recording.logs(where, damage):
                found.setdefault(name_of(episode), []).append(episode)
    single = [one for name in sorted(found) if (one := _one_of(found[name], damage)) is not None]
    every = [file for files in recordings for file in files]
    return BagContent(accept(single, damage), sorted(announced - set(found)), announced, every)


def _one_of(places: Sequence[LocatedLog], damage: Damage) -> LocatedLog | None:
    """Return the one recording of an episode that counts.

    The same one may be given twice, and an episode may have been run again after it was aborted.
    """
    completed = [one for one in places if one.log.outcome != Outcome.ABORTED]
    first, *others = completed or places
    for other in others:
        if _content(other.log) != _content(first.log):
            damage.leave_out(f"{first.text} is another one in {other.where}: give one of them")
            return None
    starts = {one.start for one in completed}
    if len(starts) > 1:
        damage.warn(f"{first.text} was run {len(starts)} times with the same result: it counts once")
    return first


def _content(log: EpisodeLog) -> tuple[object, ...]:
    """Return what two recordings of one episode have in common, to the last bit."""
    spec, phi = log.episode, log.episode.safe_trajectory
    return (
        log.outcome,
        *(array.tobytes() for array in (log.adversary, log.car)),
        *(value.hex() for value in (log.impact_time, log.impact_speed, spec.multiplier)),
        *(spec.mode, spec.seed, *shared_options(spec).values()),
        *(spec.scenario, None if phi is None else phi.positions.tobytes()),
    )


def _read_file(file: Path, graphs: dict[str, GraphRecording], damage: Damage) -> None:
    """Add the messages of a file to the graphs, by namespace; damaged ones are refused or left out.

    Raises:
        UsageError: it is no recording of this version's messages, or something must not be left out.
    """
    for message in read_messages(file, lambda topic: _namespace_and_role(topic) is not None, damage):
        topic = message.topic
        namespace, role = _namespace_and_role(topic) or ("", "")
        _check_type(message, role, file)
        try:
            content = message.decoded()
        except UsageError as error:
            damage.leave_out(f"{file}: {error}")
            continue
        try:
            graphs.setdefault(namespace, GraphRecording()).add(role, content, message)
        except UsageError as error:
            raise UsageError(f"{file}: {error}") from error
        except ValueError as error:
            damage.leave_out(f"{file}: a message on {topic} is not valid ({shortened(str(error))})")


@functools.cache
def _namespace_and_role(topic: str) -> tuple[str, str] | None:
    """Return the namespace of a topic of SKD's, and which of them it is."""
    name = next((name for name in _TOPICS if topic.endswith(name)), None)
    return None if name is None else (topic.removesuffix(name), name)


def _check_type(message: Received, role: str, file: Path) -> None:
    """Refuse a message of another type than its topic's, or of another version of SKD."""
    if message.type != _TOPICS[role]:
        raise UsageError(f"{file}: {message.topic} has type {shortened(message.type)}, expected {_TOPICS[role]}")
    if message.type.startswith("skd_msgs/") and (
        message.types.fielddefs[message.type] != typestore().fielddefs[message.type]
    ):
        raise UsageError(f"{file}: {message.type} was recorded by another version of SKD; replay it with that one")


_OPTIONS = [one for one in options_of(EpisodeSpec) if one.name != "objective"]  # a campaign may have several objectives
_SHARED = ("scenario", "seed", *(one.name for one in _OPTIONS))
_OF_KAMIKAZES = [one.name for one in _OPTIONS if PLANNING in one.marks]  # no matter in an episode that plans nothing


def _select(episodes: Sequence[checks.LocatedLog], campaign: str | None) -> list[checks.LocatedLog]:
    known = sorted({episode.campaign for episode in episodes})
    if campaign is not None and campaign not in known:
        raise UsageError(f"--campaign {campaign}: the bags hold {', '.join(known) or 'no episode'}")
    if campaign is None and len(known) > 1:
        raise UsageError(f"the bags hold {len(known)} campaigns; choose one with --campaign: {', '.join(known)}")
    return [episode for episode in episodes if campaign in (None, episode.campaign)]


def _counts(spec: EpisodeSpec) -> bool:
    """Whether an episode belongs to an assessment: those that made φ, probed a car or tried a way do not."""
    stage = split_episode_id(spec.episode_id)[0]
    return (
        spec.mode != Mode.SAFE
        and stage not in (EpisodeGroup.PROBE, EpisodeGroup.LEARNING)
        and not follows_other_trajectory(spec)
    )


def _kamikaze_count(sets: Iterable[Sequence[KamikazeSet]]) -> int:
    """Return how many kamikaze trajectories were requested for each φ.

    That is as many as were found, if that ended a set; else half of the number of trials after which a set is given
    up.
    """
    groups = [group for of_objective in sets for group in of_objective]
    return max(1, *(max(len(group.logs), len(group.episodes) // TRIALS_PER_REQUESTED) for group in groups))


def assessment_from_logs(
    recorded: BagContent,
    *,
    campaign: str | None = None,
    maximum_distance: float | None = None,
    seconds: float = 0.0,
    damage: checks.Damage | None = None,
) -> Assessment:
    """Compute the assessment of recorded episodes, by every objective of which there are kamikazes.

    Args:
        recorded: what the recordings hold, as `read_bags` returns it.
        campaign: name of the campaign to rate, if the bags hold several.
        maximum_distance: discard pairs further apart (m); the recorded campaign's own limit by default.
        seconds: time that reading took, s, which the result records.
        damage: what was left out of the recordings, and what is to be said of the rest.

    Raises:
        UsageError: no kamikaze or replay episode, several campaigns, or one campaign with different cars or scenarios.
    """
    selected = _select(recorded.episodes, campaign)
    chosen = [episode for episode in selected if _counts(episode.log.episode)]
    if not chosen:
        raise UsageError("the bags hold no kamikaze or replay episode that ended; those of skd probe are for skd fit")
    first = chosen[0].log.episode
    safe: dict[int, Trajectory] = {}
    kamikazes: dict[tuple[int, Objective], list[EpisodeLog]] = {}
    nominal: list[tuple[int, int, EpisodeLog]] = []
    for log in (episode.log for episode in chosen):
        spec = log.episode
        for name in _SHARED:
            one, other = getattr(first, name), getattr(spec, name)
            if one != other and not (name in _OF_KAMIKAZES and Mode.REPLAY in (spec.mode, first.mode)):
                what = f"the {name}" if name in ("scenario", "car_model") else f"{name} {one} and {other}"
                raise UsageError(f"the episodes of one campaign differ in {what}")
        assert spec.safe_trajectory is not None
        stage, index, trial = split_episode_id(spec.episode_id)
        if not np.array_equal(safe.setdefault(index, spec.safe_trajectory).positions, spec.safe_trajectory.positions):
            raise UsageError(f"episode {spec.episode_id} has other positions of safe trajectory {index} than others")
        if stage == EpisodeGroup.KAMIKAZE:
            kamikazes.setdefault((index, spec.objective), []).append(log)
        else:
            nominal.append((trial, index, log))
    objectives = in_order([one for _, one in kamikazes] or [first.objective])
    indices = sorted(safe)
    sets = {
        one: [
            KamikazeSet(safe[k], tuple(sorted(kamikazes.get((k, one), ()), key=lambda log: log.episode.episode_id)))
            for k in indices
        ]
        for one in objectives
    }
    replays = [log for _, _, log in sorted(nominal, key=lambda run: run[:2])]
    planned = next((logs[0].episode for logs in kamikazes.values()), first)
    plan = Plan(
        scenario=first.scenario,
        safe=RECORDED,
        safe_count=len(indices),
        kamikaze_count=_kamikaze_count(sets.values()),
        collision_runs=len(replays),
        seed=first.seed,
        **{
            **shared_options(planned),
            "objective": objectives[0],
            "maximum_distance": maximum_distance or first.maximum_distance,
        },
    )
    assessment = replace(assessment_of(plan, [safe[index] for index in indices], sets, replays), seconds=seconds)
    stands = (*standing(plan.controller, replays), *missed_periods(plan.controller, assessment.logs))
    lost = aborted_lines(assessment.as_dict()) if assessment.reasons else []
    if damage is None:
        return replace(assessment, warnings=(*lost, *stands))
    announced = [name for name in recorded.announced if name.campaign == chosen[0].campaign]
    unfinished = [name.episode_id for name in recorded.unfinished if name.campaign == chosen[0].campaign]
    lines = checks.unfinished_episodes(unfinished)
    reached = {str(one.plan.objective): one.successes_by_phi for one in assessment.results}
    requested = max((count for counts in reached.values() for count in counts), default=0)
    for objective in objectives:
        own = [name.episode_id for name in announced if name.objective in ("", objective)]
        by_index = dict(zip(indices, reached[str(objective)], strict=True))
        which = f" of objective {objective}" if len(objectives) > 1 else ""
        lines += checks.missing_episodes(
            own, by_index, requested=requested, left_out=bool(damage.left_out), which=which
        )
    lines += checks.aborted_episodes([episode.log for episode in chosen])
    lines += lost
    lines += checks.not_credible_beside(recorded.files)
    for line in dict.fromkeys(lines):  # of the runs along φ each objective says the same
        damage.warn(line)
    return replace(assessment, left_out=tuple(damage.left_out), warnings=(*damage.warnings, *stands))
