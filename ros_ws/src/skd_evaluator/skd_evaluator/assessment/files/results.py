"""An assessment on disk: writes its files, and reads its figures with the margins and curve of its trajectories."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import folders_in, real_path
from skd_sim.options.adversary import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of
from skd_sim.scenario.scenario import scenario_from_dict
from skd_sim.start import installing
from skd_sim.world.episode import EpisodeLog, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.episode_figures import SURROGATES, command_age
from skd_evaluator.assessment.figure_table import figures_html
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT, read_figures, understood
from skd_evaluator.assessment.files.episodes_npz import EPISODES, StoredEpisodes, read_episodes, write_episodes
from skd_evaluator.assessment.files.result_folder import MANIFEST, check_unchanged, write_json
from skd_evaluator.assessment.files.verification import differences, stored_risks
from skd_evaluator.metrics.aborted import in_one_line, not_credible
from skd_evaluator.metrics.risks import Risks, Touch
from skd_evaluator.metrics.skd import prefix_distances
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.metrics.vulnerability_curve import VulnerabilityCurve, vulnerability_curve
from skd_evaluator.version import version


@dataclass(frozen=True, eq=False)
class StoredResult:
    """An assessment read back.

    Attributes:
        folder: folder of the assessment.
        figures: content of its assessment.json.
        safe: positions of each φ, m.
        curve: vulnerability curve of the kamikazes that rank the car; None if every one of them was aborted.
        objective: objective of these kamikazes.
        groups: per φ, by figure: `margin`, of each trial in the order of their numbers, m, η_max where nobody can be
            hit, and not there where the margin is not known; `deviation`, what each trial of the kamikazes counts
            as, likewise; `skd` and `skd_prefix`, the Fréchet and the prefix distance of each pair of the kamikazes that
            SKD is of, m; `contact_rate`, 1 for each run along φ that collided, else 0, and `nominal_collision_rate`,
            1 for each that the moving car hit; `deviation_success_rate` and `kamikaze_success_rate` likewise of the
            trials of both; `risk_1` and so on, 1 for each crossing that is a hit, else 0, or what each replicate of
            subset simulation estimates, not there where the risk is not known.
        remarks: remarks on the assessment, and its own warnings, a line each.
        worst: those of the groups of risk and deviation that would be others if the car had hit in every episode that
            was aborted, kamikazes without any deviation.
    """

    folder: Path
    figures: Mapping[str, Any]
    safe: tuple[FloatArray, ...]
    curve: VulnerabilityCurve | None
    objective: str
    groups: Mapping[str, tuple[FloatArray, ...]]
    remarks: tuple[str, ...] = ()
    worst: Mapping[str, tuple[FloatArray, ...]] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        return figures_html(self.figures, not_credible(self.figures.get("warnings") or ()))

    @cached_property
    def scenario(self) -> dict[str, Any]:
        """Its scenario with every key of today, as plain data.

        Raises:
            UsageError: it is none.
        """
        return scenario_from_dict(self.figures["scenario"], str(self.folder)).as_dict()

    @property
    def margin_curve(self) -> VulnerabilityCurve | None:
        """The vulnerability curve of the margins; None where they are not known."""
        margins = self.groups.get("margin")
        return None if margins is None else vulnerability_curve(margins, float(self.figures["eta_max"]))

    def same_safe(self, safe: Sequence[FloatArray]) -> bool:
        """Return whether it is of these φ, positions at ticks each (m)."""
        return len(self.safe) == len(safe) and all(map(np.array_equal, self.safe, safe))

    @cached_property
    def episodes(self) -> StoredEpisodes:
        """Every episode that the folder holds."""
        return read_episodes(self.folder)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with a row for each episode: what it was, how it ended, how far it strayed.

        Columns: `episode_id`, `mode`, `objective`, `safe_index`, `outcome`, `hit`, `impact_time` (s), `impact_speed`
        (m/s), `deviation` (m; nan without a hit).

        Raises:
            UsageError: pandas is not installed.
        """
        episodes = self.episodes
        return _library("pandas").DataFrame(
            {
                "episode_id": episodes.episode_id,
                "mode": [Mode(int(one)).name.lower() for one in episodes.mode],
                "objective": episodes.objective.astype(str),
                "safe_index": episodes.safe_index,
                "outcome": [Outcome(int(one)).name.lower() for one in episodes.outcome],
                "hit": episodes.hit,
                "impact_time": episodes.impact_time,
                "impact_speed": episodes.impact_speed,
                "deviation": np.where(episodes.hit, episodes.deviation, np.nan),
            }
        )

    def to_xarray(self) -> Any:
        """Return the trajectories as an xarray.Dataset.

        `adversary` (episode, time, axis), `car` (episode, time, state) and `phi` (safe, time, axis). Times are those of
        ticks, s; positions m, the car's heading rad and speed m/s; nan after an episode's end.

        Raises:
            UsageError: xarray is not installed.
        """
        xarray, episodes = _library("xarray"), self.episodes
        ticks = max(map(len, (*episodes.adversary, *episodes.safe)), default=0)
        arrays = {
            "adversary": (("episode", "time", "axis"), _padded(episodes.adversary, ticks, 2), {"units": "m"}),
            "car": (("episode", "time", "state"), _padded(episodes.car, ticks, 4), {"units": "m, m, rad, m/s"}),
            "phi": (("safe", "time", "axis"), _padded(episodes.safe, ticks, 2), {"units": "m"}),
            "safe_index": (("episode",), episodes.safe_index),
        }
        coordinates = {
            "episode": episodes.episode_id,
            "time": ("time", episodes.time_step * np.arange(ticks), {"units": "s"}),
            "axis": ["x", "y"],
            "state": ["x", "y", "heading", "speed"],
        }
        return xarray.Dataset(arrays, coordinates, {"folder": str(self.folder)})


def _padded(trajectories: tuple[FloatArray, ...], ticks: int, width: int) -> FloatArray:
    found = np.full((len(trajectories), ticks, width), np.nan)
    for row, one in zip(found, trajectories, strict=True):
        row[: len(one)] = one
    return found


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise UsageError(f"this needs {name}: {installing('notebook')}") from error


def read_result(folder: Path) -> StoredResult:
    """Read an assessment; see `read_both`."""
    return read_both(folder)[0]


def read_checked(folder: Path) -> tuple[dict[str, Any], StoredEpisodes, tuple[str, ...]]:
    """Return the figures of an assessment, its episodes, and remarks on them, a line each.

    Both are of the same moment: whoever reads them one after the other may have two results, one replaced meanwhile.

    Raises:
        UsageError: it is none, was changed since it was written, or its trajectories give another margin, deviation
            or number of φ than it says.
    """
    known = check_unchanged(folder, (ASSESSMENT, EPISODES))
    figures, stored = read_figures(folder), read_episodes(folder)
    with understood(folder / ASSESSMENT):
        scenario_from_dict(figures["scenario"], str(folder / ASSESSMENT))
        eta_max, count = float(figures["eta_max"]), len(figures["per_safe_trajectory"])
        curve = vulnerability_curve(stored.deviations_of(first_of(RANKING_OBJECTIVES, figures["objectives"])), eta_max)
        margins = stored.margins(eta_max)
        found = {
            "margin": None if margins is None else mean(np.concatenate(margins)),
            "deviation": None if curve is None else curve.area_above,
        }
        for name, value in found.items():
            for line in differences(name, figures[name], value):
                raise UsageError(f"{folder}: {line}: they are not of one assessment")
    if count != len(stored.safe):
        raise UsageError(f"{folder / ASSESSMENT}: is of {count} φ, and {EPISODES} beside it of {len(stored.safe)}")
    remark = f"{folder}: has no {MANIFEST}: that a file was changed would not be seen"
    return figures, stored, () if known else (remark,)


def read_both(folder: Path) -> tuple[StoredResult, StoredEpisodes]:
    """Read an assessment and its episodes, and compute its margins and its curve anew from its trajectories.

    Raises:
        UsageError: it is none, is damaged, has neither a margin nor a trial, or its trajectories give another margin
            or deviation than it says.
    """
    path = folder / ASSESSMENT
    figures, stored, remarks = read_checked(folder)
    with understood(path):
        eta_max = float(figures["eta_max"])
        objective = first_of(RANKING_OBJECTIVES, figures["objectives"])
        objective_of_skd = first_of(SKD_OBJECTIVES, figures["objectives"])
    margins = stored.margins(eta_max)
    deviations = stored.deviations_of(objective)
    curve = vulnerability_curve(deviations, eta_max)
    if curve is None and margins is None:
        raise UsageError(f"{folder}: no kamikaze ran, and the margin is not known: nothing is said of the car")
    of_skd, hit = stored.trials(objective_of_skd), stored.hit.astype(np.float64)
    collided = stored.collided.astype(np.float64)
    # Where a maximum distance left some out, those that are there are not the pairs of SKD.
    limited = figures.get("maximum_distance") is not None
    distances, prefixes = _distances(stored, [mine[:0] for mine in of_skd] if limited else of_skd)
    runs = (stored.mode == Mode.REPLAY) & (stored.outcome != Outcome.ABORTED)
    groups = {
        **({} if margins is None else {"margin": margins}),
        "deviation": tuple(np.minimum(group, eta_max) for group in deviations),
        "deviation_success_rate": tuple(np.isfinite(group).astype(np.float64) for group in deviations),
        "skd": distances,
        "skd_prefix": prefixes,
        "kamikaze_success_rate": tuple(collided[mine] for mine in of_skd),
        "nominal_collision_rate": tuple(hit[runs & (stored.safe_index == index)] for index in range(len(stored.safe))),
        "contact_rate": tuple(collided[runs & (stored.safe_index == index)] for index in range(len(stored.safe))),
    }
    with understood(path):
        risks = stored_risks(figures, stored)
    if risks is not None:
        groups |= {f"risk_{one.scale:g}": one.groups for one in risks.scales if one.value is not None}
    worst = {} if risks is None else _at_worst(risks)
    lost = (stored.outcome == Outcome.ABORTED) & (stored.mode == Mode.KAMIKAZE) & (stored.objective == objective)
    if lost.any():
        more = [np.zeros(int((lost & (stored.safe_index == index)).sum())) for index in range(len(stored.safe))]
        worst["deviation"] = tuple(np.concatenate(pair) for pair in zip(groups["deviation"], more, strict=True))
    lines = (f"{folder}: {line}" for line in in_one_line(figures.get("warnings") or ()))
    return StoredResult(folder, figures, stored.safe, curve, objective, groups, (*remarks, *lines), worst), stored


def _at_worst(risks: Risks) -> dict[str, tuple[FloatArray, ...]]:
    """Return the groups of the crude risks some of whose crossings were aborted, as if the car had hit in these."""
    found = {}
    for one in risks.scales:
        if one.value is not None and one.subsets is None and one.number_of(Touch.ABORTED):
            hits = np.where(one.touches == Touch.ABORTED, int(Touch.FRONT), one.touches)
            found[f"risk_{one.scale:g}"] = replace(one, touches=hits).groups
    return found


def _distances(
    stored: StoredEpisodes, trials: Sequence[IntArray]
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Return per φ the Fréchet and the prefix distance of each pair of some trials, m."""
    step, distances, prefixes = stored.time_step, [], []
    for phi, mine in zip(stored.safe, trials, strict=True):
        hit = mine[stored.collided[mine]]
        psis = [Trajectory(stored.until_contact(number), step) for number in hit.tolist()]
        distances.append(stored.frechet[hit])
        prefixes.append(prefix_distances(Trajectory(phi, step), psis))
    return tuple(distances), tuple(prefixes)


def write_assessment(folder: Path, assessment: Assessment) -> None:
    """Write assessment.json, episodes.npz and surrogate_measures.csv."""
    write_json(folder / "assessment.json", assessment.as_dict())
    write_episodes(folder / "episodes.npz", assessment)
    with (folder / SURROGATES).open("w", encoding="utf-8") as file:
        assessment.surrogates.write_csv(file)


def episode_summary(log: EpisodeLog) -> dict[str, Any]:
    """Return the content of episode.json."""
    spec = log.episode
    collided = log.outcome == Outcome.COLLISION
    return {
        "outcome": log.outcome.name.lower(),
        "reason": log.reason,
        "mode": spec.mode.name.lower(),
        "controller": spec.controller,
        "multiplier": spec.car.stated_multiplier,
        "adversary_model": str(spec.resolved_adversary_model),
        "seed": spec.seed,
        "episode_id": spec.episode_id,
        "ticks": len(log.adversary) - 1,
        "impact_time": log.impact_time if collided else None,
        "impact_speed": log.impact_speed if collided else None,
        "command_age": command_age([log]),
        "scenario": spec.scenario.as_dict(),
        "version": version(),
    }


def assessments_below(folder: Path, unread: Callable[[Path, str], None]) -> Iterator[Path]:
    """Yield the folders at and below one that hold an assessment, in the order of their names, no hidden ones.

    Args:
        folder: where to look.
        unread: called with a folder that cannot be looked into, and why.
    """
    for path, inside, files in folders_in(folder, unread):
        inside[:] = sorted(name for name in inside if not name.startswith("."))
        if ASSESSMENT in files:
            yield path


def result_folders(paths: Sequence[Path]) -> list[Path]:
    """Return the folders of the assessments in or under some, each once.

    Raises:
        UsageError: one is not there, or holds none.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        if not path.is_dir():
            raise UsageError(f"{path}: there is no such folder")
        places = list(assessments_below(path, lambda _path, _why: None))
        if not places:
            raise UsageError(f"{path}: holds no {ASSESSMENT}, nor does a folder in it")
        for place in places:
            found.setdefault(real_path(place), place)
    return list(found.values())
