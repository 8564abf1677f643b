"""Campaigns and assessments: what counts, that it repeats, and that what is on disk gives the same figures again."""

import io
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Runner
from skd_evaluator.assessment.files.episodes_npz import write_episodes
from skd_evaluator.assessment.files.results import read_result, write_assessment
from skd_evaluator.assessment.plan import TRIALS_PER_REQUESTED, EpisodeGroup, Plan, episode_id, runs_along
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.kamikazes import kamikaze_sets
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.statistics import wilson_interval
from skd_evaluator.report.html.subjects import read_subjects
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Trajectory, UsageError, load_scenario
from stages import rate

CROSSING = load_scenario("crossing")
SMALL = Plan(CROSSING, safe_count=2, kamikaze_count=5, collision_runs=7, seed=3, simulations=100)


def rated(plan: Plan, safe: Sequence[Trajectory], runner: Runner) -> Assessment:
    return rate(plan, [plan.objective], safe, runner)


def straight(y: float = 0.0, name: str = "straight") -> Trajectory:
    x = np.arange(-3.5, 3.0, 0.75)
    return Trajectory(np.column_stack([x, np.full_like(x, y)]), CROSSING.time_step, name)


class StubRunner:
    """Ends every episode as `decide` says, and remembers what was asked for."""

    def __init__(self, decide: Callable[[EpisodeSpec], Outcome]) -> None:
        self.decide = decide
        self.batches: list[list[EpisodeSpec]] = []

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        self.batches.append(list(episodes))
        for episode in episodes:
            start = np.array(episode.start)
            walked = start + np.array([[0.0, 0.0], [0.5, 0.0], [1.0, -1.0]])
            hit = (0.5, 4.0) if (outcome := self.decide(episode)) == Outcome.COLLISION else ()
            reason = "no answer: the controller is silent" if outcome == Outcome.ABORTED else ""
            yield EpisodeLog(episode, outcome, walked, np.zeros((3, 4)), *hit, reason=reason)


def trial(episode: EpisodeSpec) -> int:
    return episode.episode_id & 0xFFFFFFFF


def each_by_turns(episode: EpisodeSpec) -> Outcome:
    return (Outcome.ABORTED, Outcome.COLLISION, Outcome.ARRIVED)[trial(episode) % 3]


def test_episodes_are_drawn_until_enough_have_collided():
    runner = StubRunner(lambda episode: Outcome.COLLISION if trial(episode) % 3 else Outcome.MISSED)
    (found,) = kamikaze_sets(SMALL, [straight()], runner)
    assert [trial(log.episode) for log in found.logs] == [1, 2, 4, 5, 7]
    assert (len(found.episodes), found.aborted) == (8, 0)
    assert [len(batch) for batch in runner.batches] == [5, 2, 1]


def test_drawing_ends_at_the_cap():
    runner = StubRunner(lambda _episode: Outcome.TIMEOUT)
    sets = kamikaze_sets(SMALL, [straight(), straight(1.0)], runner)
    assert [(len(found.logs), len(found.episodes)) for found in sets] == [(0, TRIALS_PER_REQUESTED * 5)] * 2


def test_no_kamikaze_found_is_none_and_not_zero():
    found = rated(SMALL, [straight(), straight(1.0)], StubRunner(lambda _episode: Outcome.MISSED))
    result = found.as_dict()
    for key in ("skd", "skd_ci95_pairs", "skd_ci95", "skd_prefix", "variance", "mean_impact_speed"):
        assert result[key] is None
    assert (result["pairs"], result["kamikaze_success_rate"], result["probability_bound"]) == (0, 0.0, {})
    assert result["contact_rate_ci95_runs"] == pytest.approx(wilson_interval(0, 7))
    assert (result["deviation"], result["deviation_of_successes"]) == (5.0, None)  # η_max
    write_episodes(io.BytesIO(), found)


def test_one_kamikaze_trajectory_has_no_variance_and_no_bound():
    plan = replace(SMALL, kamikaze_count=1)
    result = rated(plan, [straight()], StubRunner(lambda _episode: Outcome.COLLISION)).as_dict()
    assert result["skd"] > 0.0
    assert (result["pairs"], result["variance"], result["skd_ci95_pairs"]) == (1, None, None)
    assert result["probability_bound"] == {}
    json.dumps(result, allow_nan=False)


def test_what_reads_a_result_leaves_aborted_episodes_out_too(tmp_path):
    """They stand in episodes.npz, and report, comparison and gate compute from it."""
    found = rated(SMALL, [straight(), straight(1.0)], StubRunner(each_by_turns))
    write_assessment(tmp_path, found)
    (subject,) = read_subjects([tmp_path])
    (kamikazes,) = found.results
    tried = [len(group.finished) for group in kamikazes.kamikaze]
    assert list(map(len, subject.assessment.for_deviation.trial_deviations)) == tried
    result, figures = read_result(tmp_path), found.as_dict()
    assert [len(group) for group in result.groups["deviation"]] == tried
    for name in ("deviation", "contact_rate", "kamikaze_success_rate"):
        assert np.mean(np.concatenate(result.groups[name])) == pytest.approx(figures[name])


@pytest.mark.parametrize(("runs", "count"), [(500, 5), (7, 2), (2, 3)])
def test_collision_runs_are_dealt_evenly(runs, count):
    safe = [straight(0.1 * k, f"{k}") for k in range(count)]
    episodes = runs_along(replace(SMALL, collision_runs=runs), safe)
    assert len({one.episode_id for one in episodes}) == len(episodes) == runs
    dealt = [sum(one.safe_trajectory is phi for one in episodes) for phi in safe]
    assert max(dealt) - min(dealt) <= 1
    assert {one.mode for one in episodes} == {Mode.REPLAY}


def test_safe_trajectories_are_those_that_arrive():
    runner = StubRunner(lambda episode: Outcome.ARRIVED if trial(episode) in (1, 4) else Outcome.COLLISION)
    assert [phi.name for phi in safe_trajectories(SMALL, runner)] == ["synthetic/1", "synthetic/4"]
    with pytest.raises(UsageError, match="only 0 of 2 safe trajectories"):
        safe_trajectories(SMALL, StubRunner(lambda _episode: Outcome.COLLISION))


@pytest.mark.parametrize("name", ["crossing", "cpna", "right_turn"])
def test_walkers_are_as_many_different_safe_crossings_as_are_asked_for(name):
    plan = Plan(load_scenario(name), safe="walkers", safe_count=30, seed=4)
    runner = InProcessRunner(1)
    safe, end = safe_trajectories(plan, runner), plan.scenario.end
    assert len({phi.positions.tobytes() for phi in safe}) == len({phi.name for phi in safe}) == 30
    for phi in safe:
        arrived = [end.arrived(x, y) for x, y in phi.positions.tolist()]
        assert arrived == [False] * (len(phi) - 1) + [True]
    # none is hit by the paper's safest car under the draws with which the crossing was found
    numbers = [episode_id(EpisodeGroup.SAFE, 0, int(phi.name.removeprefix("walkers/"))) for phi in safe]
    along = [
        EpisodeSpec(plan.scenario, Mode.REPLAY, 4, number, safe_trajectory=phi, multiplier=1.15)
        for number, phi in zip(numbers, safe, strict=True)
    ]
    assert {log.outcome for log in runner.run(along)} == {Outcome.ARRIVED}
    fewer = safe_trajectories(replace(plan, safe_count=7), runner)
    assert [phi.positions.tobytes() for phi in fewer] == [phi.positions.tobytes() for phi in safe[:7]]
    others = safe_trajectories(replace(plan, seed=5), runner)
    assert not {phi.positions.tobytes() for phi in others} & {phi.positions.tobytes() for phi in safe}


def test_walkers_are_pedestrians():
    with pytest.raises(UsageError, match="--safe walkers needs a pedestrian; cyclist has a cyclist"):
        Plan(load_scenario("cyclist"), safe="walkers")


def test_episode_ids_are_unique_and_bounded():
    ids = {episode_id(stage, phi, k) for stage in EpisodeGroup for phi in (0, 1, 65535) for k in (0, 1, 2**32 - 1)}
    assert len(ids) == 9 * len(EpisodeGroup)
    assert max(ids) < 2**63
    for safe_index, number in ((-1, 0), (65536, 0), (0, -1), (0, 2**32)):
        with pytest.raises(ValueError, match="out of range"):
            episode_id(EpisodeGroup.KAMIKAZE, safe_index, number)
