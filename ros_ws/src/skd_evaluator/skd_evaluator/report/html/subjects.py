"""What a report is of: the assessments in folders, and of each the scene and episodes that the page's script draws.

They are packed as gzip of JSON in base64, which has no character that means anything in HTML.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json, real_path
from skd_sim.options.car_and_adversary import RANKING_OBJECTIVES, first_of
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Mode, Outcome
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes, failing_episodes
from skd_evaluator.assessment.files.results import read_checked, result_folders
from skd_evaluator.files import tails
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.report.formats import kept_failures


@dataclass(frozen=True, eq=False)
class Subject:
    """An assessment of one car.

    Attributes:
        folder: folder of the assessment.
        label: name in the report, which no other assessment in it has.
        kind: kind of φ if the assessment is part of a sweep, else empty.
        figures: content of assessment.json.
        episodes: content of episodes.npz.
        assessment: what follows from these.
        remarks: remarks on its figures, a line each.
    """

    folder: Path
    label: str
    kind: str
    figures: Mapping[str, Any]
    episodes: StoredEpisodes
    assessment: Assessment
    remarks: tuple[str, ...] = ()

    @property
    def ranking_objective(self) -> str:
        """The objective whose kamikazes rank the car."""
        return first_of(RANKING_OBJECTIVES, self.figures["objectives"])

    @property
    def ranking(self) -> Mapping[str, Any]:
        """The figures of those kamikazes."""
        found: Mapping[str, Any] = self.figures["objectives"][self.ranking_objective]
        return found

    @property
    def warnings(self) -> list[str]:
        """Remarks on its figures, and why they are not credible, a line each."""
        return [*self.remarks, *not_credible(self.figures["warnings"] or ())]

    @property
    def curve(self) -> Mapping[str, Any] | None:
        """The vulnerability curve; None where no kamikaze ran."""
        found: Mapping[str, Any] | None = self.figures["vulnerability_curve"]
        return found

    @property
    def scenario(self) -> Scenario:
        """Scenario of the test."""
        return self.assessment.plan.scenario

    @cached_property
    def margins(self) -> tuple[FloatArray, ...]:
        """Per φ what each trial of the margin counts as, m; none of each where it is not known."""
        margins = self.assessment.margins
        return (np.empty(0),) * len(self.episodes.safe) if margins is None else margins.per_phi

    @cached_property
    def failing(self) -> StoredEpisodes:
        """The most likely failures of the risk that are kept, as episodes, kind by kind (`kept_failures`)."""
        return failing_episodes(self.episodes, [one.row for one in kept_failures(self.figures)])

    @cached_property
    def safe_key(self) -> bytes:
        """Equal for subjects of the same φ, in the same order."""
        return b"|".join(one.tobytes() for one in self.episodes.safe)


def scenarios_of(subjects: Sequence[Subject]) -> list[str]:
    """Return the names of the scenarios, in the order in which they come."""
    return list(dict.fromkeys(one.scenario.name for one in subjects))


def read_subjects(folders: Sequence[Path]) -> list[Subject]:
    """Return the assessments in folders of assessments, sweeps and campaigns, in the order given.

    Raises:
        UsageError: a folder holds none, or one that is damaged or of another version.
    """
    if len(set(map(real_path, folders))) < len(folders):
        raise UsageError("a folder is given twice")
    found: list[Subject] = []
    for folder in folders:
        if (folder / "assessment.json").exists():
            found.append(_read(folder, ""))
        elif (folder / "sweep.json").exists():
            found += _read_sweep(folder)
        elif (folder / "campaign.json").exists():
            found += _read_campaign(folder)
        else:
            found += [_read(place, "") for place in result_folders([folder])]
    return _with_labels(found)


def read_one(folders: Sequence[Path]) -> Subject:
    """Return the one assessment in folders.

    Raises:
        UsageError: likewise, or it holds several.
    """
    subject, *others = read_subjects(folders)
    if others:
        count = f"{1 + len(others)} assessments"
        raise UsageError(f"{folders[0]}: holds {count}; give the folder of one, as {subject.folder}")
    return subject


def _read_sweep(folder: Path) -> list[Subject]:
    parts = sorted(folder.glob("*/C_*/assessment.json"))
    if not parts:
        raise UsageError(f"{folder}: a sweep without its assessments (KIND/C_…/assessment.json)")
    found = [_read(part.parent, part.parent.parent.name) for part in parts]
    if strange := next((one.folder for one in found if one.figures["multiplier"] is None), None):
        raise UsageError(f"{strange}: is of a car without a multiplier C, and so of no sweep")
    return sorted(found, key=lambda one: (one.kind != "synthetic", one.kind, float(one.figures["multiplier"])))


def _read_campaign(folder: Path) -> list[Subject]:
    path = folder / "campaign.json"
    content = read_json(path)
    try:
        names = [str(row["name"]) for row in content["cells"] if row["state"] == "done"]
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path}: is not of a campaign") from error
    if strange := next((name for name in names if Path(name).name != name), None):
        raise UsageError(f"{path}: {strange!r} is no name of a cell's folder")
    if not names:
        raise UsageError(f"{folder}: a campaign of which no cell is done")
    return [_read(folder / name, "") for name in names]


def _read(folder: Path, kind: str) -> Subject:
    figures, episodes, assessment, remarks = read_checked(folder)
    return Subject(folder, str(figures["car"]), kind, figures, episodes, assessment, remarks)


def _with_labels(subjects: Sequence[Subject]) -> list[Subject]:
    """Return subjects that have a label of their own: the car, where need be with its φ, else with its folder."""
    cars = Counter(one.label for one in subjects)
    with_kind = Counter((one.label, one.kind) for one in subjects)
    found = []
    for one, tail in zip(subjects, tails([one.folder for one in subjects]), strict=True):
        label = one.label
        if cars[label] > 1:
            alone = one.kind and with_kind[one.label, one.kind] == 1
            label = f"{label} ({one.kind} φ)" if alone else f"{label} ({tail})"
        found.append(replace(one, label=label))
    return found


_LANE = 80.0  # m of the lane to each side of the crossing
_DIGITS = 2  # of metres
RESOLUTION = 0.01
"""m, m/s, and ten times that of a heading in rad: units of an episode's path."""
_OUTCOMES = {
    Outcome.COLLISION: "touched", Outcome.ARRIVED: "arrived", Outcome.MISSED: "missed", Outcome.TIMEOUT: "time was up",
    Outcome.ABORTED: "aborted", Outcome.RUNNING: "not ended",
}  # fmt: skip


def pack(content: Mapping[str, Any]) -> str:
    """Return data of the page as one block of text."""
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode("ascii")


def scene(subject: Subject) -> dict[str, Any]:
    """Return road (edges of its lanes and arrows on them, m), car, adversary, others and φ of a subject."""
    scenario = subject.scenario
    names = [str(row["name"]) for row in subject.figures["per_safe_trajectory"]]
    return {
        "lanes": [[_rounded(edge) for edge in edges] for edges in scenario.road.surfaces(-_LANE, _LANE)],
        "arrows": [_rounded(arrow) for arrow in scenario.road.arrows(-_LANE, _LANE)],
        "obstacles": [_rounded(one.corners) for one in scenario.obstacles],
        "others": [_other(scenario, index) for index in range(len(scenario.others))],
        "car": {"front": scenario.car.front, "rear": scenario.car.rear, "half": scenario.car.half_width},
        "user": {"kind": scenario.adversary.kind, **_body(scenario.adversary.shape)},
        "timeStep": subject.episodes.time_step,
        "safe": [
            {"name": name, "points": _rounded(phi)} for name, phi in zip(names, subject.episodes.safe, strict=True)
        ],
    }


def _body(shape: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip(("radius", "halfLength", "halfWidth"), shape, strict=True))


def _other(scenario: Scenario, index: int) -> dict[str, Any]:
    """Return shape, places (m) and headings (rad) at ticks of one of the others; one place of one that stands."""
    other = scenario.others[index]
    states = [scenario.others_at(tick)[index] for tick in range(1 if other.stands else scenario.ticks + 1)]
    places = np.array([state[:2] for state in states])
    return {**_body(other.shape), "points": _rounded(places), "headings": [round(state.heading, 3) for state in states]}


def _rounded(points: FloatArray) -> list[list[float]]:
    return [[round(float(x), _DIGITS), round(float(y), _DIGITS)] for x, y in points]


def margin_hits(subject: Subject, most: int) -> list[list[dict[str, Any]]]:
    """Return per φ the margin trajectories, the least first, at most so many: points at ticks, m, and their figures."""
    found: list[list[dict[str, Any]]] = []
    for hits in subject.episodes.margin_hits or [()] * len(subject.episodes.safe):
        known = sorted(((hit, trial) for trial, hit in enumerate(hits) if hit), key=lambda one: one[0].distance)
        figures = [
            {"deviation": round(hit.distance, 3), "impactSpeed": round(hit.impact_speed, 2), "trial": trial}
            for hit, trial in known[:most]
        ]
        points = [_rounded(hit.trajectory.positions) for hit, _ in known[:most]]
        found.append([{"points": places, **one} for places, one in zip(points, figures, strict=True)])
    return found


def chosen_episodes(
    subject: Subject, episode: int | None, objective: str | None, fits: Callable[[int], bool] = lambda _number: True
) -> list[int]:
    """Return the numbers of the episodes with an id, else of all, the worst for the car first.

    Args:
        subject: the result.
        episode: their id; None: any.
        objective: whose kamikazes are meant; None: of any, and runs along φ.
        fits: whether the episode of a number is meant.

    Raises:
        UsageError: there is none.
    """
    stored = subject.episodes
    found: list[int] = [
        number
        for number in stored.worst_first().tolist()
        if objective in (None, str(stored.objective[number]))
        and episode in (None, int(stored.episode_id[number]))
        and fits(number)
    ]
    if not found and episode is not None:
        held = f"{subject.folder} holds no such episode; the report has the id of each"
        raise UsageError(f"--episode {episode}: {held}")
    if not found:
        raise UsageError(f"{subject.folder}: holds no episode of that kind: every one was aborted, or none was run")
    return found


def episode_entry(subject: Subject, number: int) -> dict[str, Any]:
    """Return what files say of an episode: which it is, how it ended, and figures of its contact."""
    stored = subject.episodes
    hit = bool(stored.collided[number])
    return {
        "episode_id": int(stored.episode_id[number]),
        "mode": Mode(int(stored.mode[number])).name.lower(),
        "objective": str(stored.objective[number]),
        "outcome": Outcome(int(stored.outcome[number])).name.lower(),
        **{key: float(getattr(stored, key)[number]) if hit else None for key in ("deviation", "impact_speed")},
    }


def worst_first(subjects: Sequence[Subject]) -> list[tuple[int, int]]:
    """Return (subject, number) of every episode, the worst for its car first."""
    pairs = [(index, int(number)) for index, one in enumerate(subjects) for number in one.episodes.worst_first()]
    return sorted(pairs, key=lambda pair: subjects[pair[0]].episodes.badness(pair[1]))


def believed_car(scenario: Scenario, car: FloatArray, belief: FloatArray) -> FloatArray | None:
    """Return what was believed at each tick, n × 4; None where nothing is known.

    First how far ahead of its true place on the road the car was believed to be, and the standard deviation of that, m;
    then its speed and the standard deviation of that, m/s. Where nobody decided any more it is what was last believed,
    the car moving on.

    Args:
        scenario: scenario of the test.
        car: n × 2 or more, place (x, y) of the car's reference point at ticks, m.
        belief: what was believed of the car at ticks, n × 4, as in `skd_sim.world.episode.EpisodeLog`.
    """
    known = np.isfinite(belief).all(axis=1)
    if not known.any():
        return None
    along = right_and_along(scenario.road.line, np.ascontiguousarray(car[:, :2]))[:, 1]
    found = np.column_stack([belief[:, 0] - along, belief[:, 1:]])
    ticks = np.arange(len(found))
    last = np.maximum.accumulate(np.where(known, ticks, np.flatnonzero(known)[0]))
    return found[last]


def episode_data(index: int, subject: Subject, stored: StoredEpisodes, number: int) -> dict[str, Any]:
    """Return an episode as the page has it.

    Its `path` holds x and y of the adversary, x and y of the car, its speed and its heading, each in units of
    `RESOLUTION` as the first value and the differences from tick to tick; the last is at the contact. `belief` likewise
    holds what `believed_car` says of each tick. None: not known.

    Args:
        index: of the subject in the page.
        subject: the assessment.
        stored: its episodes, or its failures.
        number: of the episode among these.
    """
    known = bool(np.isfinite(stored.car[number]).all())  # else it was aborted before it began
    belief = believed_car(subject.scenario, stored.car[number], stored.belief[number]) if stored.belief else None
    return {
        "subject": index,
        "phi": int(stored.safe_index[number]),
        "objective": str(stored.objective[number]),
        "outcome": "hit" if stored.hit[number] else _OUTCOMES[Outcome(int(stored.outcome[number]))],
        "touched": bool(stored.collided[number]),
        "trial": int(stored.episode_id[number] & 0xFFFF_FFFF),
        "deviation": _figure(stored.deviation[number]),
        "frechet": _figure(stored.frechet[number]),
        "time": _figure(stored.impact_time[number]),
        "speed": _figure(stored.impact_speed[number]),
        "path": _path(subject, stored, number) if known else None,
        "belief": None if belief is None else _steps(belief),
    }


def _figure(value: float) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None


def _path(subject: Subject, stored: StoredEpisodes, number: int) -> list[list[int]]:
    car = stored.car_until_contact(number, subject.scenario)
    heading = 10.0 * np.unwrap(car[:, 2])
    return _steps(np.column_stack([stored.until_contact(number), car[:, :2], car[:, 3], heading]))


def _steps(values: FloatArray) -> list[list[int]]:
    steps: list[list[int]] = np.diff(np.rint(values / RESOLUTION).astype(np.int64), axis=0, prepend=0).T.tolist()
    return steps
