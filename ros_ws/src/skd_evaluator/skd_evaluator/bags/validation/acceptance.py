"""Logs that belong together: which of them count, which are left out, and what has to be said about the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skd_sim.episode.episode import EpisodeLog

from skd_evaluator.bags.validation.damage import Damage
from skd_evaluator.campaign.validation.verdict import Verdict, examine


@dataclass(frozen=True)
class Found:
    """A log and where it was found.

    Attributes:
        log: what happened in one episode.
        where: file or other origin, for messages.
        campaign: name of the campaign to which the episode belongs.
    """

    log: EpisodeLog
    where: str
    campaign: str

    @property
    def name(self) -> str:
        """File and episode, for messages."""
        return f"{self.where}: episode {self.log.episode.episode_id}"


def accept(found: Sequence[Found], damage: Damage) -> list[int]:
    """Return which logs count, as indices: each is examined, alone and beside the others.

    Left out is what cannot have happened, what has the very states of another episode although their draws differ, and
    what SKD's own world would not have given in a campaign of which it gave other episodes. Where it gave none, the
    recording is of another simulator: it counts, checked within that simulator's freedom only, and a warning says so.

    Args:
        found: logs of any number of campaigns, each episode once.
        damage: told what is left out, and what is to be said.

    Raises:
        UsageError: something would have to be left out, and `damage` does not allow it.
    """
    verdicts = [examine(one.log) for one in found]
    ours = {one.campaign for one, verdict in zip(found, verdicts, strict=True) if _telling(one, verdict)}
    kept: list[int] = []
    states: dict[tuple[str, bytes, bytes], Found] = {}
    for index, (one, verdict) in enumerate(zip(found, verdicts, strict=True)):
        twin = states.setdefault((one.campaign, one.log.adversary.tobytes(), one.log.car.tobytes()), one)
        if verdict.fault:
            damage.leave_out(f"{one.name}: {verdict.fault}")
        elif not verdict.ours and one.campaign in ours:
            damage.leave_out(
                f"{one.name}: {verdict.where} does not follow from its other states (by {verdict.deviation:.3g}), "
                "though this campaign ran in SKD's own world"
            )
        elif twin is not one and _draws(one.log) and len(one.log.car) > 1 and not _same_draws(one.log, twin.log):
            damage.leave_out(f"{one.name}: has the very states of episode {twin.log.episode.episode_id} ({twin.where})")
        else:
            kept.append(index)
    _say(found, verdicts, kept, damage)
    return kept


def _telling(one: Found, verdict: Verdict) -> bool:
    """Whether a log shows that its campaign ran in SKD's own world."""
    return verdict.ours and len(one.log.car) > 1


def _same_draws(one: EpisodeLog, other: EpisodeLog) -> bool:
    """Whether two logs are of kamikazes of one episode, of other objectives or models, which may well walk alike."""
    planned = [(log.episode.objective, log.episode.car_model) for log in (one, other)]
    return one.episode.episode_id == other.episode.episode_id and planned[0] != planned[1]


def _draws(log: EpisodeLog) -> bool:
    """Whether two episodes of a scenario cannot have the same states."""
    car = log.episode.scenario.car
    return car.start_gap_range > 0.0 or car.speed_noise > 0.0


def _say(found: Sequence[Found], verdicts: Sequence[Verdict], kept: Sequence[int], damage: Damage) -> None:
    """Say once for each campaign what a reader should know of the logs that count."""
    for campaign in dict.fromkeys(found[index].campaign for index in kept):
        of_it = [(found[index], verdicts[index]) for index in kept if found[index].campaign == campaign]
        foreign = [pair for pair in of_it if not pair[1].ours]
        if foreign:
            one, verdict = max(foreign, key=lambda pair: pair[1].deviation)
            damage.warn(
                f"{_episodes(len(foreign))} did not run in SKD's own world ({verdict.where} is off "
                f"by {verdict.deviation:.3g}, {one.name}): another simulator's impacts are checked roughly"
            )
        rounded = [pair for pair in of_it if pair[1].ours and pair[1].rounded > 0.0]
        if rounded:
            one, verdict = rounded[0]
            damage.warn(
                f"{_episodes(len(rounded))} differ in the last digits from what this machine computes "
                f"({verdict.rounded_where}, {one.name})"
            )
        late = [pair for pair in of_it if pair[1].late and pair[1].ours]
        if late:
            ticks = sum(verdict.late for _, verdict in late)
            damage.warn(
                f"{_episodes(len(late))} obeyed a command later than lockstep would, in {ticks} ticks in all: was the "
                "pacing real_time?"
            )
        rough = [pair for pair in of_it if pair[1].ours and not pair[1].whole and len(pair[0].log.car) > 1]
        if rough:
            scenario = rough[0][0].log.episode.scenario
            car = f"with dynamics {scenario.car.dynamics}"
            if scenario.control_periods > 1:
                car = f"that decides every {scenario.control_duration:g} s, between ticks"
            damage.warn(f"{_episodes(len(rough))} have a car {car}, whose motion and impacts are checked roughly")


def _episodes(count: int) -> str:
    return f"{count} episode" if count == 1 else f"{count} episodes"
