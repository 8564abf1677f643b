"""`skd verify`: whether the files of a result are what was written, and whether its figures follow from its episodes.

The assessment is computed again from episodes.npz by the functions that computed it first. Nothing that the file names
is imported. What a car is called, how much was searched and what was requested stay what assessment.json says of them.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import folders_in, read_json, sha256_of
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment, assessment_of
from skd_evaluator.assessment.failures import Walkers, failures_of
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT, read_figures, understood
from skd_evaluator.assessment.files.episodes_npz import EPISODES, StoredEpisodes, failing_episodes, read_episodes
from skd_evaluator.assessment.files.result_folder import CHANGED, GONE, MANIFEST, compared, read_manifest
from skd_evaluator.assessment.objective_result import CONFIDENCE, KamikazeSet, kamikaze_set
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.metrics.behaviour.model import NAMES
from skd_evaluator.metrics.margins import Excess, Margins, Search
from skd_evaluator.metrics.risks import Risks, ScaleRisk, Subsets, Touch


@dataclass(frozen=True)
class _StoredPlan(Plan):
    """A plan of which the file says what its objectives plan for, so that none of them has to be loaded."""

    plans: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        pass  # its scenario is as it was run, and its car is nobody's

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
    names, objectives = further["safe_name"].tolist(), further["objectives"].tolist()
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
    safe = [Trajectory(one, stored.time_step, name) for one, name in zip(stored.safe, names, strict=True)]
    logs = [_log(stored, number, scenario, safe) for number in range(len(stored))]
    replays = [log for log in logs if log.episode.mode == Mode.REPLAY]
    sets: dict[Objective, list[KamikazeSet]] = {}
    for name in objectives:
        of_it = (stored.mode == Mode.KAMIKAZE) & (stored.objective == name)
        rows = [np.flatnonzero(of_it & (stored.safe_index == index)).tolist() for index in range(len(safe))]
        # A registered objective is not looked up: of a name alone all that is wanted is the name.
        sets[cast(Objective, name)] = [
            kamikaze_set(phi, sorted((logs[row] for row in mine), key=lambda log: log.episode.episode_id))
            for phi, mine in zip(safe, rows, strict=True)
        ]
    confidence = _confidence(figures)
    assessment = assessment_of(plan, safe, sets, replays, confidence)
    margins = _stored_margins(figures, stored, scenario, confidence)
    risks = stored_risks(figures, stored, confidence)
    seconds = float(figures["seconds"])
    return replace(
        assessment, seconds=seconds, margins=margins, risks=risks and _with_failures(risks, stored, scenario)
    )


def _confidence(figures: Mapping[str, Any]) -> float:
    """Return the confidence of the intervals by φ: that of each look, where there were several."""
    until = figures.get("until_width")
    found = CONFIDENCE if until is None else float(until["confidence"])
    if not CONFIDENCE <= found < 1.0:
        raise ValueError(f"until_width.confidence must be from {CONFIDENCE:g} to below 1, got {found:g}")
    return found


def _log(stored: StoredEpisodes, number: int, scenario: Scenario, safe: list[Trajectory]) -> EpisodeLog:
    episode = EpisodeSpec(
        scenario,
        Mode(int(stored.mode[number])),
        int(stored.further["seed"]),
        int(stored.episode_id[number]),
        safe_trajectory=safe[int(stored.safe_index[number])],
    )
    return stored.log(number, episode)


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
    return Margins(stored.margin_hits, scenario.eta_max, search, confidence)


def stored_risks(figures: Mapping[str, Any], stored: StoredEpisodes, confidence: float = CONFIDENCE) -> Risks | None:
    """Return the risk that the stored ends of its crossings give; None where the file has none.

    Raises:
        ValueError, LookupError: its arrays do not go together.
    """
    further, phis = stored.further, len(stored.safe)
    if "risk_touch" not in further:
        return None
    scales = further["risk_scale"].tolist()
    touches = further["risk_touch"].astype(np.int64).reshape(len(scales), -1)
    ticks = further["risk_tick"].astype(np.int64).reshape(touches.shape)
    lost = further["risk_lost"].tolist() if "risk_lost" in further else [0] * len(scales)
    levels = further["risk_levels"].reshape(len(scales), -1)
    shares = further["risk_share"].reshape(len(scales), -1, phis)
    if not np.isin(touches, [*map(int, Touch)]).all():
        raise ValueError("risk_touch has a value that this version does not know")
    found = []
    for row, scale in enumerate(scales):
        per_level, subsets = int(further["risk_per_level"][row]), None
        if per_level:
            subsets = Subsets(shares[row], levels[row], per_level, int(further["risk_open"][row]))
        found.append(ScaleRisk(scale, touches[row], phis, subsets, confidence, ticks[row], lost[row]))
    return Risks(figures["risk"]["behaviour"], found)


def _with_failures(risks: Risks, stored: StoredEpisodes, scenario: Scenario) -> Risks:
    """Return the risks with the most likely failures, computed anew but for what the car did.

    Raises:
        ValueError, LookupError: those that are kept are others.
    """
    parameters = risks.behaviour["parameters"]
    values = np.array([float(parameters[name]["value"]) for name in NAMES])
    walkers = Walkers(scenario, stored.safe, int(stored.further["seed"]), values)
    found, failing = failures_of(risks.scales, walkers), failing_episodes(stored)
    rows = [] if found is None else sorted(one.row for one in found.nearest)
    if found is None:
        if len(failing):
            raise ValueError("failures are kept, and no crossing is one")
        return risks
    if rows != stored.further["risk_failure"].tolist():
        raise ValueError("the failures that are kept are not those nearest to how people walk")
    return replace(risks, failures=found.as_dict(dict(zip(rows, failing.impact_speed.tolist(), strict=True))))


_CAMPAIGN = "campaign.json"
_AGREE = 1e-7
"""Relative to a figure, or to 1: what another machine's rounding may come to in an interval, which is searched for."""
_KEPT = (("vulnerability_curve", "budgets"), ("risk", "behaviour"))
"""Parts of figures that do not follow from the episodes: kamikazes that are not kept, and a model that was given."""


@dataclass(frozen=True)
class Verified:
    """What was found out about a folder.

    Attributes:
        folder: folder that was looked at.
        files: files that are not as its manifest has them, what is wrong by name; None if it has no manifest.
        agree: names of figures that follow from its episodes.
        contradict: figures that do not, a line each.
        unknown: names of figures that cannot be recomputed from the folder.
        problems: whatever else is wrong, a line each.
        remarks: remarks for the reader, a line each.
    """

    folder: Path
    files: Mapping[str, str] | None
    agree: tuple[str, ...] = ()
    contradict: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def fine(self) -> bool:
        """Whether nothing was found that speaks against the folder."""
        return not (self.contradict or self.problems or {CHANGED, GONE} & {*(self.files or {}).values()})

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**dataclasses.asdict(self), "folder": str(self.folder), "fine": self.fine}


def folders_below(folder: Path) -> list[Path]:
    """Return the folders of results at and below one, itself first; links are not followed.

    Raises:
        UsageError: there is none, or a folder cannot be looked into.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; give that of a result")

    def refuse(path: Path, why: str) -> None:
        raise UsageError(f"{path}: {why}")

    names = {ASSESSMENT, MANIFEST, _CAMPAIGN}
    found = sorted(path for path, _, files in folders_in(folder, refuse) if names & set(files))
    if not found:
        raise UsageError(f"{folder}: holds no {ASSESSMENT} and no {MANIFEST}; give the folder of a result")
    return found


def verify(folder: Path) -> Verified:
    """Return what is to be said of a folder of a result, whatever is wrong with it."""
    found = Verified(folder, None)
    try:
        manifest = read_manifest(folder)
        if manifest is not None:
            found = replace(found, files=compared(folder, manifest))
        elif not (folder / _CAMPAIGN).exists():
            found = replace(found, remarks=(f"no {MANIFEST}: that a file was changed would not be seen",))
        if (folder / _CAMPAIGN).exists():
            found = replace(found, problems=_rows_that_differ(folder))
        if (folder / ASSESSMENT).exists() or ASSESSMENT in (manifest or {}):
            figures, stored = read_figures(folder), read_episodes(folder)
            found = replace(found, remarks=(*found.remarks, *not_credible(figures.get("warnings") or ())))
            with understood(folder / ASSESSMENT):
                again = json.loads(json.dumps(assessment_from_file(figures, stored).as_dict()))
                agree, contradict = _compared(figures, again)
            unknown = tuple(name for name in figures if name in AT_THE_TOP and not AT_THE_TOP[name].recomputed)
            found = replace(found, agree=agree, contradict=contradict, unknown=unknown)
    except UsageError as error:
        found = replace(found, problems=(*found.problems, str(error)))
    return found


def _follows(name: str) -> bool:
    """Return whether an entry at the top of assessment.json follows from the episodes beside it."""
    return name in AT_THE_TOP and AT_THE_TOP[name].recomputed


def _compared(figures: Mapping[str, Any], found: dict[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return which figures are those that were found again, and in a line each what the others are."""
    for name, part in _KEPT:
        if figures.get(name) and found.get(name):
            found[name][part] = figures[name].get(part)
    agree, contradict = [], []
    for name in dict.fromkeys((*figures, *found)):
        if _follows(name.partition("_ci95")[0]):
            said = [*differences(name, figures.get(name), found.get(name))]
            contradict += said
            agree += [] if said else [name]
    return tuple(agree), tuple(contradict)


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


def _rows_that_differ(folder: Path) -> tuple[str, ...]:
    """Return which rows of a campaign are not of the results in the folders of its cells, a line each."""
    path = folder / _CAMPAIGN
    with understood(path):
        return tuple(
            f"{path}: cell {row['name']}: {name} is not the file that the row is of"
            for row in read_json(path)["cells"]
            for name, digest in row["sha256"].items()
            if sha256_of(folder / row["name"] / name) != digest
        )
