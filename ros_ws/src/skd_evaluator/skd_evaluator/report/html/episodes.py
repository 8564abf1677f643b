"""What the page's script draws: the scene of each subject and the episodes in it, packed as gzip of JSON in base64.

Base64 has no character that means anything in HTML, so no name in the data can.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Outcome

from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes
from skd_evaluator.report.episode_pictures import believed_car
from skd_evaluator.report.html.subjects import Subject

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


def unpack(block: str) -> dict[str, Any]:
    """Return what `pack` was given."""
    content: dict[str, Any] = json.loads(gzip.decompress(base64.b64decode(block)))
    return content


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
    return {
        **_body(other.shape),
        "points": _rounded(places),
        "headings": [round(state.heading, 3) for state in states],
    }


def _rounded(points: FloatArray) -> list[list[float]]:
    return [[round(float(x), _DIGITS), round(float(y), _DIGITS)] for x, y in points]


def margin_hits(subject: Subject, most: int) -> list[list[dict[str, Any]]]:
    """Return per φ the margin trajectories, the least first, at most so many: points at ticks, m, and their figures."""
    found: list[list[dict[str, Any]]] = []
    for hits in subject.episodes.margin_hits or [()] * len(subject.episodes.safe):
        known = [(hit.distance, trial, hit) for trial, hit in enumerate(hits) if hit is not None]
        found.append(
            [
                {
                    "points": _rounded(hit.trajectory.positions),
                    "deviation": round(distance, 3),
                    "impactSpeed": round(hit.impact_speed, 2),
                    "trial": trial,
                }
                for distance, trial, hit in sorted(known, key=lambda one: one[:2])[:most]
            ]
        )
    return found


def worst_first(subjects: Sequence[Subject]) -> list[tuple[int, int]]:
    """Return (subject, number) of every episode, the worst for its car first."""
    pairs = [(index, int(number)) for index, one in enumerate(subjects) for number in one.episodes.worst_first()]
    return sorted(pairs, key=lambda pair: subjects[pair[0]].episodes.badness(pair[1]))


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
