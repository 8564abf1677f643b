"""episodes.npz: every trajectory of an assessment, written and read back, so that its figures can be computed anew.

docs/files.md says what each array holds.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import numpy.typing as npt
from skd_adversary.adversary import BelievedCar
from skd_sim.errors import UsageError
from skd_sim.inputs.files import open_regular
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome, until_contact
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_evaluator.assessment.assessment import Assessment, ObjectiveResult
from skd_evaluator.assessment.plan import EpisodeGroup, episode_id, probed, split_episode_id
from skd_evaluator.metrics.contact_place import car_until_contact
from skd_evaluator.metrics.deviation import Hit, deviation_pairs
from skd_evaluator.metrics.frechet import discrete_frechet_pairs
from skd_evaluator.metrics.risks import ScaleRisk, Touch

Array = npt.NDArray[Any]


_NOWHERE = (math.nan, math.nan)

Columns = dict[str, Any]  # name → array; numpy's savez would take one of arrays for its own options


def write_episodes(path: Path | IO[bytes], assessment: Assessment) -> None:
    """Write every trajectory of an assessment; docs/files.md says what each array holds.

    First is Φ, then, objective by objective and φ by φ, every kamikaze episode in the order of its trials, those that
    failed or were aborted too; last are the runs along φ. A kamikaze is told by its objective and its id: those of
    different objectives with one id have the same draws. Arrays that begin with `margin` are of the ways of least
    deviation, which were not planned.
    """
    plan, rows = assessment.plan, list[tuple[EpisodeLog, int, str]]()  # with the number of φ and the objective
    for index, phi in enumerate(assessment.safe):
        nowhere = np.full((len(phi), 4), np.nan)  # Φ was recorded, or made against another car
        episode = EpisodeSpec(plan.scenario, Mode.SAFE, plan.seed, 0)
        rows.append((EpisodeLog(episode, Outcome.ARRIVED, phi.positions, nowhere, math.nan, math.nan), index, ""))
    for result in assessment.results:
        for index, kamikaze in enumerate(result.kamikaze):
            rows += [(log, index, str(result.plan.objective)) for log in kamikaze.episodes]
    rows += [(log, _index_of(assessment, log), "") for log in assessment.nominal_runs]
    logs = [log for log, _, _ in rows]
    columns = episode_columns(logs)
    if any(log.belief is not None for log in logs):
        columns["belief"] = _beliefs(logs)
    if any(log.own_contact is not None for log in logs):
        columns["own_contact"] = np.array([math.nan if log.own_contact is None else log.own_contact for log in logs])
    np.savez_compressed(
        path,
        **columns,
        safe_index=np.array([index for _, index, _ in rows], np.int32),
        objective=np.array([objective for _, _, objective in rows], "U16"),
        safe_name=_texts([one.name for one in assessment.safe]),
        **_margin_columns(assessment),
        **_risk_columns(assessment),
        **_settings(plan.scenario, plan.seed, plan.maximum_distance, assessment.results),
    )


def write_probes(path: Path, logs: Sequence[EpisodeLog]) -> None:
    """Write episodes of a probe, which has no φ."""
    scenario, count = logs[0].episode.scenario, len(logs)
    np.savez_compressed(
        path,
        **episode_columns(logs),
        safe_index=np.zeros(count, np.int32),
        objective=np.zeros(count, "U16"),
        safe_name=_texts([]),
        **_settings(scenario, logs[0].episode.seed),
    )


def episode_columns(logs: Sequence[EpisodeLog]) -> Columns:
    """Return the arrays of episodes.npz that follow from logs alone, in their order."""
    states = np.concatenate([np.empty((0, 4)), *(log.car for log in logs)])
    return {
        "positions": np.concatenate([np.empty((0, 2)), *(log.adversary for log in logs)]),
        "car": states[:, [0, 1, 3]],
        "heading": states[:, 2],
        "offsets": np.cumsum([0, *(len(log.adversary) for log in logs)], dtype=np.int64),
        "mode": np.array([int(log.episode.mode) for log in logs], np.int8),
        "outcome": np.array([int(log.outcome) for log in logs], np.int8),
        "episode_id": np.array([log.episode.episode_id for log in logs], np.int64),
        "impact_time": np.array([log.impact_time for log in logs], np.float64),
        "impact_speed": np.array([log.impact_speed for log in logs], np.float64),
        "contact": np.array([_contact(log) for log in logs], np.float64).reshape(-1, 2),
        "clipped": np.array([log.clipped for log in logs], np.int64),
        "reason": _texts([log.reason for log in logs]),
    }


def _index_of(assessment: Assessment, log: EpisodeLog) -> int:
    """Return the number of the φ that a run is along; recordings need not have every φ, so it may not be its own."""
    phi, number = log.episode.safe_trajectory, split_episode_id(log.episode.episode_id)[1]
    assert phi is not None
    alike = [k for k, one in enumerate(assessment.safe) if np.array_equal(one.positions, phi.positions)]
    return number if number in alike else alike[0]


def _settings(
    scenario: Scenario, seed: int, maximum_distance: float | None = None, results: Sequence[ObjectiveResult] = ()
) -> Columns:
    """Return what the figures depend on beside the trajectories."""
    return {
        "time_step": np.array(scenario.time_step),
        "eta_max": np.array(scenario.eta_max),
        "hit_speed": np.array(scenario.collision.hit_speed),
        "maximum_distance": np.array(math.nan if maximum_distance is None else maximum_distance),
        "seed": np.array(seed, np.int64),
        "objectives": _texts([str(one.plan.objective) for one in results]),
        "plans_deviation": np.array([one.plan.limits_deviation for one in results], np.bool_),
    }


def _contact(log: EpisodeLog) -> tuple[float, float]:
    """Return where the adversary was at the first contact, m; nan without one."""
    if log.outcome != Outcome.COLLISION:
        return _NOWHERE
    x, y = log.trajectory.positions[-1].tolist()
    return x, y


def _beliefs(logs: Sequence[EpisodeLog]) -> npt.NDArray[np.float32]:
    """Return the adversary's belief of the car at each state; nan where there was none, or it is not known.

    In millimetres, finer than any use of it, a file of them is half as large.
    """
    nothing = (len(BelievedCar._fields),)
    parts = [np.full((len(log.car), *nothing), np.nan) if log.belief is None else log.belief for log in logs]
    return np.round(np.concatenate(parts), 3).astype(np.float32)


def _texts(texts: Sequence[str]) -> npt.NDArray[np.str_]:
    return np.array(texts, f"U{max(1, *map(len, texts))}" if texts else "U1")


def _margin_columns(assessment: Assessment) -> Columns:
    """Return the least way of each trial of the margin, φ by φ; nothing where the margin is not known.

    A trial without a way has no position, and counts as η_max.
    """
    if assessment.margins is None:
        return {}
    rows = [(index, trial, hit) for index, mine in enumerate(assessment.margins.hits) for trial, hit in enumerate(mine)]
    hits = [hit for _, _, hit in rows]
    lengths = [0 if hit is None else len(hit.trajectory) for hit in hits]
    return {
        "margin": np.array([math.nan if hit is None else hit.distance for hit in hits]),
        "margin_gap": np.array([math.nan if hit is None else hit.gap for hit in hits]),
        "margin_safe_index": np.array([index for index, _, _ in rows], np.int32),
        "margin_trial": np.array([trial for _, trial, _ in rows], np.int64),
        "margin_duration": np.array([math.nan if hit is None else hit.duration for hit in hits]),
        "margin_impact_speed": np.array([math.nan if hit is None else hit.impact_speed for hit in hits]),
        "margin_positions": np.concatenate(
            [np.empty((0, 2)), *(w.trajectory.positions for w in hits if w is not None)]
        ),
        "margin_offsets": np.cumsum([0, *lengths], dtype=np.int64),
    }


def _contact_ticks(risk: ScaleRisk) -> npt.NDArray[np.int32]:
    """Return of each crude crossing the number of the tick of a hit, from 1; 0 of one that is none."""
    ticks = np.zeros(len(risk.touches), np.int32) if risk.ticks is None else risk.ticks
    return np.where(risk.touches == Touch.FRONT, ticks, 0).astype(np.int32)


def _risk_columns(assessment: Assessment) -> Columns:
    """Return how the crossings of the risk ended, scale by scale; nothing where the risk is not known.

    What subset simulation estimates on each φ is replicates × φ, nan at scales at which it was not asked.
    """
    if assessment.risks is None:
        return {}
    scales = assessment.risks.scales
    subsets = [one.subsets for one in scales]
    replicates = max((len(one.levels) for one in subsets if one is not None), default=0)
    shares, levels = np.full((replicates, len(assessment.safe)), math.nan), np.zeros(replicates, np.int64)
    return {
        "risk_scale": np.array([one.scale for one in scales]),
        "risk_touch": np.array([one.touches for one in scales], np.int8).reshape(-1),
        "risk_share": np.array([shares if one is None else one.shares for one in subsets]).reshape(-1),
        "risk_levels": np.array([levels if one is None else one.levels for one in subsets], np.int64).reshape(-1),
        "risk_per_level": np.array([0 if one is None else one.per_level for one in subsets], np.int64),
        "risk_open": np.array([0 if one is None else one.open_levels for one in subsets], np.int64),
        "risk_tick": np.concatenate([_contact_ticks(one) for one in scales]),
        **({"risk_lost": np.array([one.lost for one in scales], np.int64)} if any(one.lost for one in scales) else {}),
        **(failure_columns(assessment.risks.failing) if assessment.risks.failing else {}),
    }


EPISODES = "episodes.npz"


_OF_STATES = ("car", "heading", "belief")
_OF_EPISODES = ("clipped", "reason", "own_contact")
_OF_FAILURES = ("positions", "car", "heading", "offsets", "impact_time", "impact_speed")
_PER_EPISODE: dict[str, Any] = {
    **dict.fromkeys(("mode", "safe_index", "outcome", "episode_id"), np.int64),
    **dict.fromkeys(("impact_time", "impact_speed"), np.float64),
    "objective": np.str_,
}


@dataclass(frozen=True, eq=False)
class StoredEpisodes:
    """Episodes read back from disk; row k of every array is of episode k, and safe trajectories are no episodes here.

    Attributes:
        safe: positions of each φ at ticks, m.
        time_step: time step of the scenario, s.
        adversary: for each episode the adversary's positions at ticks, n × 2, m.
        car: for each episode the car at ticks as in `EpisodeLog`, n × 4.
        mode: mode of each episode, kamikaze or replay (`skd_sim.world.episode.Mode`).
        objective: objective of each kamikaze; empty for a run along φ.
        safe_index: number of the φ of each episode, counted from 0.
        outcome: how each episode ended (`skd_sim.world.episode.Outcome`).
        episode_id: id of each episode, as `skd_evaluator.assessment.plan.episode_id` makes it.
        impact_time: time of the contact, s; nan without a collision.
        impact_speed: speed of the car at the contact, m/s; nan without a collision.
        hit_speed: speed of the car, m/s, from which on a collision is a hit.
        margin_hits: per φ the trajectory of minimal deviation of each trial; None: no hit within η_max.
        belief: per episode n × 4 as in `skd_sim.world.episode.EpisodeLog`, nan where nothing is known; none
            where the file holds none.
        further: arrays that figures follow from and that nothing is drawn of, by name, those of episodes without the
            rows of φ.
    """

    safe: tuple[FloatArray, ...]
    time_step: float
    adversary: tuple[FloatArray, ...]
    car: tuple[FloatArray, ...]
    mode: IntArray
    objective: npt.NDArray[np.str_]
    safe_index: IntArray
    outcome: IntArray
    episode_id: IntArray
    impact_time: FloatArray
    impact_speed: FloatArray
    belief: tuple[FloatArray, ...] = ()
    hit_speed: float = 0.0
    margin_hits: tuple[tuple[Hit | None, ...], ...] = ()
    further: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.mode)

    @cached_property
    def trajectories(self) -> list[Trajectory]:
        """Each φ."""
        names = self.further["safe_name"].tolist()
        return [Trajectory(one, self.time_step, name) for one, name in zip(self.safe, names, strict=True)]

    def logs(self, like: EpisodeSpec) -> list[EpisodeLog]:
        """Return what happened in each episode; what the file does not hold of its specification is as in another one.

        Raises:
            ValueError, LookupError: that is not possible.
        """
        own_contacts = self.further["own_contact"].tolist() if "own_contact" in self.further else [None] * len(self)
        return [
            EpisodeLog(
                self._episode(number, like),
                Outcome(int(self.outcome[number])),
                self.adversary[number],
                self.car[number],
                float(self.impact_time[number]),
                float(self.impact_speed[number]),
                reason=str(self.further["reason"][number]),
                clipped=int(self.further["clipped"][number]),
                own_contact=own_contact,
            )
            for number, own_contact in enumerate(own_contacts)
        ]

    def _episode(self, number: int, like: EpisodeSpec) -> EpisodeSpec:
        id_ = int(self.episode_id[number])
        if split_episode_id(id_)[0] == EpisodeGroup.PROBE:
            phi = probed(like.scenario, like.seed, id_)
        else:
            phi = self.trajectories[self.safe_index[number]]
        # A registered objective is not looked up: who reads figures needs its name alone.
        objective = cast(Objective, str(self.objective[number])) or like.objective
        mode = Mode(int(self.mode[number]))
        return replace(like, mode=mode, episode_id=id_, safe_trajectory=phi, objective=objective)

    @cached_property
    def collided(self) -> npt.NDArray[np.bool_]:
        """For each episode, whether it ended in a collision."""
        return np.asarray(self.outcome == Outcome.COLLISION)

    @cached_property
    def hit(self) -> npt.NDArray[np.bool_]:
        """For each episode, whether it ended in a hit by the moving car."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.collided & (self.impact_speed >= self.hit_speed))

    def impact(self, number: int) -> tuple[float, float]:
        """Return time (s) and speed of the car (m/s) at the contact of an episode; nan without one."""
        return float(self.impact_time[number]), float(self.impact_speed[number])

    def until_contact(self, number: int) -> FloatArray:
        """Return the adversary's places in an episode, n × 2, the last one moved back to the contact, if any."""
        if not self.collided[number]:
            return self.adversary[number]
        return until_contact(self.adversary[number], float(self.impact_time[number]) / self.time_step)

    def car_until_contact(self, number: int, scenario: Scenario) -> FloatArray:
        """Return the car's states in an episode of a scenario, n × 4, the last moved back to the contact, if any."""
        if not self.collided[number]:
            return self.car[number]
        ticks = float(self.impact_time[number]) / self.time_step
        impact, adversary = float(self.impact_speed[number]), self.until_contact(number)[-1]
        return car_until_contact(scenario, self.car[number], ticks, impact, adversary)

    @cached_property
    def deviation(self) -> FloatArray:
        """Deviation of each episode that collided, m; nan for the others."""
        found = np.full(len(self), np.nan)
        for index, phi in enumerate(self.safe):
            mine = np.flatnonzero(self.collided & (self.safe_index == index))
            psis = [self.until_contact(int(number)) for number in mine]
            found[mine] = deviation_pairs(phi, psis, self.impact_time[mine] / self.time_step)
        return found

    @cached_property
    def frechet(self) -> FloatArray:
        """Discrete Fréchet distance to φ of each kamikaze that collided, m; nan for the others."""
        found = np.full(len(self), np.nan)
        kamikaze = self.collided & (self.mode == Mode.KAMIKAZE)
        for index, phi in enumerate(self.safe):
            mine = np.flatnonzero(kamikaze & (self.safe_index == index))
            found[mine] = discrete_frechet_pairs(phi, [self.until_contact(int(number)) for number in mine])
        return found

    def worst_first(self) -> IntArray:
        """Return the numbers of all episodes, the worst for the car first; see `badness`."""
        return np.array(sorted(range(len(self)), key=self.badness), np.int64)

    def badness(self, number: int) -> tuple[float, float, int]:
        """Return a key by which episodes stand in order, the worst for the car first.

        Those that collided by their deviation, and of those hit on φ itself the fastest impact; then the others.
        """
        hit = bool(self.hit[number])
        deviation = round(float(self.deviation[number]), 9) if hit else np.inf
        return deviation, -float(self.impact_speed[number]) if hit else 0.0, int(self.episode_id[number])


def read_episodes(folder: Path, name: str = EPISODES) -> StoredEpisodes:
    """Read episodes.npz of a folder, of an assessment or of a probe, which has no φ.

    Raises:
        UsageError: it cannot be read, or is damaged (its checksums are compared).
    """
    path = folder / name
    with open_regular(path) as stream:
        try:
            with np.load(stream, allow_pickle=False) as file:
                return _stored({one: file[one] for one in file.files})
        except Exception as error:  # its readers raise whatever the bytes make them raise
            said = " ".join(f"{type(error).__name__}: {error}".split())[:120]
            raise UsageError(f"{path}: is not an episodes.npz of SKD, or is damaged ({said})") from error


def _stored(arrays: Mapping[str, Array]) -> StoredEpisodes:
    """Return the episodes in the arrays of a file."""
    rest = np.flatnonzero(arrays["mode"] != Mode.SAFE)
    phis = _taken(arrays, np.flatnonzero(arrays["mode"] == Mode.SAFE)).adversary
    further = {name: one for name, one in arrays.items() if name not in (*_PER_EPISODE, "positions", *_OF_STATES)}
    return _taken(
        arrays,
        rest,
        phis,
        margin_hits=_margin_hits(arrays, phis),
        further={name: one[rest] if name in _OF_EPISODES else one for name, one in further.items()},
    )


def _taken(
    arrays: Mapping[str, Any], rows: Sequence[int] | IntArray, safe: tuple[FloatArray, ...] = (), **more: Any
) -> StoredEpisodes:
    """Return some of the episodes in the arrays of a file."""
    chosen = np.asarray(rows, np.int64)
    spans = [slice(*ends) for ends in itertools.pairwise(arrays["offsets"].tolist())]

    def each(states: Array) -> tuple[FloatArray, ...]:
        return tuple(states[spans[row]] for row in chosen)

    return StoredEpisodes(
        safe=safe,
        time_step=float(arrays["time_step"]),
        adversary=each(arrays["positions"]),
        car=each(np.column_stack([arrays["car"][:, :2], arrays["heading"], arrays["car"][:, 2]])),
        belief=each(arrays["belief"].astype(np.float64)) if "belief" in arrays else (),
        hit_speed=float(arrays["hit_speed"]),
        **{name: arrays[name][chosen].astype(kind) for name, kind in _PER_EPISODE.items()},
        **more,
    )


def _margin_hits(arrays: Mapping[str, Array], safe: Sequence[FloatArray]) -> tuple[tuple[Hit | None, ...], ...]:
    """Return per φ the trajectory of minimal deviation of each trial, its deviation computed anew; () without any."""
    if not len(arrays.get("margin", ())):
        return ()
    said, offsets, step, found = arrays["margin"], arrays["margin_offsets"], float(arrays["time_step"]), []
    for number, phi in enumerate(safe):
        rows = np.flatnonzero(arrays["margin_safe_index"] == number)
        known = rows[np.isfinite(said[rows])]
        tracks = [arrays["margin_positions"][offsets[row] : offsets[row + 1]] for row in known.tolist()]
        durations, speeds, gaps = (arrays[f"margin_{one}"][known] for one in ("duration", "impact_speed", "gap"))
        distances = deviation_pairs(phi, tracks, durations)
        columns = ([Trajectory(track, step) for track in tracks], durations.tolist(), speeds.tolist(), gaps.tolist())
        hits = dict(zip(known.tolist(), map(Hit, distances.tolist(), *columns), strict=True))
        found.append(tuple(hits.get(row) for row in rows.tolist()))
    return tuple(found)


def failure_columns(failing: Mapping[int, EpisodeLog]) -> Columns:
    """Return the arrays of episodes.npz about the failures that are kept, in the order of their numbers."""
    columns = episode_columns([failing[row] for row in sorted(failing)])
    return {
        "risk_failure": np.array(sorted(failing), np.int64),
        **{f"risk_failure_{name}": columns[name] for name in _OF_FAILURES},
    }


def failing_episodes(stored: StoredEpisodes, order: Sequence[int] | None = None) -> StoredEpisodes:
    """Return the failures that a file keeps as episodes, none where it has none.

    Args:
        stored: the episodes of the file.
        order: numbers of crossings, in which order they come; None: that of their numbers.

    Raises:
        ValueError, LookupError: the arrays do not go together.
    """
    further, phis, nothing = stored.further, len(stored.safe), episode_columns([])
    there = further["risk_failure"].tolist() if "risk_failure" in further else []
    columns = {name: further.get(f"risk_failure_{name}", nothing[name]) for name in _OF_FAILURES}
    columns |= {
        "mode": np.full(len(there), int(Mode.REPLAY)),
        "objective": np.full(len(there), "", "U16"),
        "safe_index": np.array([row % phis for row in there], np.int64),
        "outcome": np.full(len(there), int(Outcome.COLLISION)),
        "episode_id": np.array([episode_id(EpisodeGroup.RISK, row % phis, row // phis) for row in there], np.int64),
        "time_step": np.array(stored.time_step),
        "hit_speed": np.array(stored.hit_speed),
    }
    return _taken(columns, [there.index(row) for row in (there if order is None else order)], stored.safe)
