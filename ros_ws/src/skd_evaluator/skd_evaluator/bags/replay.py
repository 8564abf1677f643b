"""Offline SKD: the assessment from recorded episodes, by the same code as live."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import Objective
from skd_sim.options.options import PLANNING, options_of, shared_options
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment, KamikazeSet, assessment_of, in_order
from skd_evaluator.assessment.episode_figures import missed_periods, standing
from skd_evaluator.assessment.options import RECORDED
from skd_evaluator.assessment.plan import (
    TRIALS_PER_REQUESTED,
    EpisodeGroup,
    Plan,
    follows_other_trajectory,
    split_episode_id,
)
from skd_evaluator.bags import checks
from skd_evaluator.bags.read import BagContent
from skd_evaluator.metrics.aborted import aborted_lines

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
