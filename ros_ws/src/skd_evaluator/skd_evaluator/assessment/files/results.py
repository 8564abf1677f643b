"""An assessment on disk: writes its files, and reads its figures with the margins and curve of its trajectories."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import folders_in, real_path
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.start import installing
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.assessment import CONFIDENCE, Assessment, KamikazeSet, ObjectiveResult, assessment_of
from skd_evaluator.assessment.episode_figures import SURROGATES, command_age
from skd_evaluator.assessment.figure_table import figures_html
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT, read_figures, understood
from skd_evaluator.assessment.files.episodes_npz import EPISODES, StoredEpisodes, read_episodes, write_episodes
from skd_evaluator.assessment.files.result_folder import MANIFEST, check_unchanged, write_json
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.files import check_folder
from skd_evaluator.metrics.aborted import in_one_line, not_credible
from skd_evaluator.metrics.margins import Excess, Margins, Search
from skd_evaluator.metrics.risks import Risks, ScaleRisk, Subsets, Touch
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
        groups: per φ, by figure: `margin`, of each trial in the order of their numbers, m, η_max where none can be
            hit, and not there where the margin is not known; `impact_speed`, of the car in these trials, m/s, nan
            without a hit; `deviation`, what each trial of the kamikazes counts
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
    """Read an assessment and its episodes, and compute its margins and deviations again from its trajectories.

    Raises:
        UsageError: it is none, was changed since it was written, has neither a margin nor a trial, or its trajectories
            give another margin, deviation or number of φ than it says.
    """
    check_folder(folder)
    if missing := [name for name in (ASSESSMENT, EPISODES) if not (folder / name).exists()]:
        raise UsageError(f"{folder}: holds no {missing[0]}; give a folder that skd assess --out has written")
    figures, episodes, assessment, remarks = read_checked(folder)
    curve = vulnerability_curve(assessment.for_deviation.trial_deviations, assessment.plan.scenario.eta_max)
    if curve is None and assessment.margins is None:
        raise UsageError(f"{folder}: no kamikaze ran, and the margin is not known: nothing is said of the car")
    lines = (f"{folder}: {line}" for line in in_one_line(figures.get("warnings") or ()))
    groups = groups_of(assessment)
    return StoredResult(
        folder, figures, episodes.safe, curve, groups, (*remarks, *lines), _at_worst(assessment, groups["deviation"])
    )


def read_checked(folder: Path) -> tuple[dict[str, Any], StoredEpisodes, Assessment, tuple[str, ...]]:
    """Return the figures of an assessment, its episodes, what these come to, and remarks on them, a line each.

    All are of the same moment: of files that are read one after the other one may be replaced meanwhile.

    Raises:
        UsageError: see `read_result`.
    """
    known = check_unchanged(folder, (ASSESSMENT, EPISODES))
    figures, episodes = read_figures(folder), read_episodes(folder)
    count = len(figures["per_safe_trajectory"])
    if count != len(episodes.safe):
        raise UsageError(f"{folder / ASSESSMENT}: is of {count} φ, and {EPISODES} beside it of {len(episodes.safe)}")
    with understood(folder / ASSESSMENT):
        assessment = assessment_from_file(figures, episodes)
        found = {"margin": assessment.margins and assessment.margins.mean}
        found["deviation"] = assessment.for_deviation.deviation.mean
    for name, value in found.items():
        for line in differences(name, figures[name], value):
            raise UsageError(f"{folder}: {line}: they are not of one assessment")
    remark = f"{folder}: has no {MANIFEST}: that a file was changed would not be seen"
    return figures, episodes, assessment, () if known else (remark,)


def groups_of(assessment: Assessment) -> dict[str, tuple[FloatArray, ...]]:
    """Return the values of each φ by figure; see `StoredResult.groups`."""
    ranking, of_skd = assessment.for_deviation, assessment.for_skd
    margins, risks = assessment.margins, assessment.risks
    return {
        **({} if margins is None else {"margin": margins.per_phi, "impact_speed": margins.impacts}),
        "deviation": ranking.deviation.groups,
        "deviation_success_rate": _successes(ranking),
        "skd": of_skd.skd.distances.groups,
        "skd_prefix": of_skd.skd.prefixes.groups,
        "kamikaze_success_rate": _successes(of_skd),
        "nominal_collision_rate": _shares(assessment.nominal_collision_rate.counts),
        "contact_rate": _shares(assessment.contact_rate.counts),
        **{f"risk_{one.scale:g}": one.groups for one in (risks.scales if risks else ()) if one.value is not None},
    }


def _successes(result: ObjectiveResult) -> tuple[FloatArray, ...]:
    return tuple(np.array([*map(result.plan.succeeds, group.finished)], np.float64) for group in result.kamikaze)


def _shares(counts: Sequence[tuple[int, int]]) -> tuple[FloatArray, ...]:
    return tuple((np.arange(runs) < hits).astype(np.float64) for hits, runs in counts)


def _at_worst(assessment: Assessment, deviations: Sequence[FloatArray]) -> dict[str, tuple[FloatArray, ...]]:
    """Return the groups that would be others if the car had hit in every aborted episode; see `StoredResult.worst`."""
    found = {}
    for one in assessment.risks.scales if assessment.risks else ():
        if one.value is not None and one.subsets is None and one.number_of(Touch.ABORTED):
            hits = np.where(one.touches == Touch.ABORTED, int(Touch.FRONT), one.touches)
            found[f"risk_{one.scale:g}"] = replace(one, touches=hits).groups
    kamikazes = assessment.for_deviation.kamikaze
    if any(group.aborted for group in kamikazes):
        pairs = zip(deviations, kamikazes, strict=True)
        found["deviation"] = tuple(np.append(mine, np.zeros(group.aborted)) for mine, group in pairs)
    return found


@dataclass(frozen=True)
class _StoredPlan(Plan):
    """A plan of which the file says what its objectives plan for, so that none of them has to be loaded."""

    plans: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        pass  # its scenario is as it was run, and its car is not run

    @property
    def limits_deviation(self) -> bool:
        return self.plans[str(self.objective)]


def assessment_from_file(figures: Mapping[str, Any], stored: StoredEpisodes) -> Assessment:
    """Return the assessment that stored episodes give.

    Args:
        figures: content of assessment.json, of which scenario, confidence and how the margin was searched are taken.
        stored: the episodes.

    Raises:
        ValueError, LookupError: they do not go together.
    """
    further = stored.further
    scenario = scenario_from_dict(figures["scenario"], f"scenario in {ASSESSMENT}")
    objectives = further["objectives"].tolist()
    for name, here, there in (
        ("η_max", float(further["eta_max"]), scenario.eta_max),
        ("time step", stored.time_step, scenario.time_step),
        ("hit speed", stored.hit_speed, scenario.collision.hit_speed),
    ):
        if here != there:
            raise ValueError(f"{EPISODES} is of a scenario whose {name} is {here:g}, and not {there:g}")
    limit = float(further["maximum_distance"])
    plan = _StoredPlan(
        scenario,
        safe_count=len(stored.safe),
        seed=int(further["seed"]),
        maximum_distance=None if math.isnan(limit) else limit,
        plans=dict(zip(objectives, further["plans_deviation"].tolist(), strict=True)),
    )
    safe, logs = stored.trajectories, stored.logs(EpisodeSpec(scenario, Mode.SAFE, plan.seed, 0))
    replays = [log for log in logs if log.episode.mode == Mode.REPLAY]
    sets: dict[Objective, list[KamikazeSet]] = {}
    for name in objectives:
        of_it = (stored.mode == Mode.KAMIKAZE) & (stored.objective == name)
        rows = [np.flatnonzero(of_it & (stored.safe_index == index)).tolist() for index in range(len(safe))]
        sets[cast(Objective, name)] = [
            KamikazeSet(phi, tuple(logs[row] for row in mine)) for phi, mine in zip(safe, rows, strict=True)
        ]
    confidence = _confidence(figures)
    assessment = assessment_of(plan, safe, sets, replays, confidence)
    margins = _stored_margins(figures, stored, scenario, confidence)
    risks = _stored_risks(figures, stored, confidence)
    return replace(assessment, seconds=float(figures["seconds"]), margins=margins, risks=risks)


def _confidence(figures: Mapping[str, Any]) -> float:
    """Return the confidence of the intervals by φ: that of each look, where there were several."""
    until = figures.get("until_width")
    return CONFIDENCE if until is None else float(until["confidence"])


def _stored_margins(
    figures: Mapping[str, Any], stored: StoredEpisodes, scenario: Scenario, confidence: float
) -> Margins | None:
    if not stored.margin_hits:
        return None
    search = None
    if (budget := figures["margin_budget"]) is not None:
        excess = None if figures["margin_excess"] is None else Excess(**figures["margin_excess"])
        converged, sources = bool(figures["margin_converged"]), tuple(figures["margin_sources"] or ())
        search = Search(budget, converged, excess, sources, figures["margin_how"] or "")
    return Margins(stored.margin_hits, scenario.eta_max, search, confidence, figures.get("margin_lanes") or {})


def _stored_risks(figures: Mapping[str, Any], stored: StoredEpisodes, confidence: float) -> Risks | None:
    """Return the risk that the stored ends of its crossings give; None where the file has none."""
    further, phis = stored.further, len(stored.safe)
    if "risk_touch" not in further:
        return None
    scales = further["risk_scale"].tolist()
    touches = further["risk_touch"].astype(np.int64).reshape(len(scales), -1)
    ticks = further["risk_tick"].astype(np.int64).reshape(touches.shape)
    lost = further["risk_lost"].tolist() if "risk_lost" in further else [0] * len(scales)
    levels = further["risk_levels"].reshape(len(scales), -1)
    shares = further["risk_share"].reshape(len(scales), -1, phis)
    found = []
    for row, scale in enumerate(scales):
        per_level, subsets = int(further["risk_per_level"][row]), None
        if per_level:
            subsets = Subsets(shares[row], levels[row], per_level, int(further["risk_open"][row]))
        found.append(ScaleRisk(scale, touches[row], phis, subsets, confidence, ticks[row], lost[row]))
    return Risks(figures["risk"]["behaviour"], found)


_AGREE = 1e-7
"""Relative to a figure, or to 1: what another machine's rounding may come to in an interval, which is searched for."""


def differences(name: str, said: Any, found: Any) -> Iterator[str]:
    """Yield, a line each, where two values of JSON differ by more than rounding."""
    if isinstance(said, Mapping) and isinstance(found, Mapping):
        for key in dict.fromkeys((*said, *found)):
            yield from differences(f"{name}.{key}", said.get(key), found.get(key))
    elif isinstance(said, list) and isinstance(found, list) and len(said) == len(found):
        for place, (one, other) in enumerate(zip(said, found, strict=True)):
            yield from differences(f"{name}.{place}", one, other)
    elif not _alike(said, found):
        yield f"{name} is {_shown(said)}, its episodes give {_shown(found)}"


def _alike(said: Any, found: Any) -> bool:
    if isinstance(said, float) or isinstance(found, float):
        numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in (said, found))
        return numbers and abs(said - found) <= _AGREE * max(1.0, abs(said), abs(found))
    return bool(said == found)


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    return f"{value:.6g}" if isinstance(value, float) else f"{value!r:.60}"


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
        check_folder(path)
        places = list(assessments_below(path, lambda _path, _why: None))
        if not places:
            raise UsageError(f"{path}: holds no {ASSESSMENT}, nor does a folder in it")
        for place in places:
            found.setdefault(real_path(place), place)
    return list(found.values())
