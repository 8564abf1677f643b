"""A cell of a campaign: one assessment that is ready to run, all that its figures depend on, and its row.

A row is what campaign.json says of the cell, with the SHA-256 of the files of its result.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.options.adversary import OBJECTIVES, Objective, objectives_named
from skd_sim.options.car_under_test import SIMULATORS, CarUnderTest
from skd_sim.options.options import options_of, values_of
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import RiskRequest
from skd_evaluator.assessment.figure_table import columns
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.episode_store import digest_of, digest_of_trajectory
from skd_evaluator.assessment.files.episodes_npz import EPISODES
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.options import GENERATED, OF_NO_RESULT, CampaignOptions, GraphOptions
from skd_evaluator.assessment.plan import TRIALS_PER_REQUESTED, Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.kamikazes import BOUNDS, bounded_trials
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.extensions.campaign.campaign_file import Combination
from skd_evaluator.provenance import code_digests, environment
from skd_evaluator.report.warnings import warnings_of, why_failed


@dataclass(frozen=True)
class Cell:
    """One assessment.

    Attributes:
        name: name of its folder.
        plan: what to assess, whatever its objective.
        requested: what is requested of its stages: `objectives`, `margin_limit`, `curve` and `risk` of `Context`.
        graph: how to run the node graph; None: its episodes run in process.
        answer_limit: how long a call of a user's controller may take, s.
        swept: the values that the campaign sweeps, by key.
        identity: all that its figures depend on, as plain data.
        where: its place in the campaign file, for error lines.
    """

    name: str
    plan: Plan
    requested: Mapping[str, Any]
    graph: GraphOptions | None
    answer_limit: float
    swept: Mapping[str, Any]
    identity: Mapping[str, Any]
    where: str

    @property
    def key(self) -> bytes:
        """Digest of its identity."""
        return digest_of(self.identity)

    def episodes(self, trials: int = 1) -> int:
        """Return how many episodes it has if a kamikaze takes so many trials and every generated φ arrives."""
        plan, curve = self.plan, bounded_trials(self.plan) * len(BOUNDS) if self.requested["curve"] else 0
        kamikazes = trials * plan.kamikaze_count * len(self.requested["objectives"]) + curve
        return plan.safe_count * (kamikazes + (plan.safe in GENERATED)) + plan.collision_runs


def make_cells(combinations: Iterable[Combination]) -> list[Cell]:
    """Check what a file asks for as `skd assess` would, and return the cells.

    Raises:
        UsageError: a scenario, controller or source is not there, or does not go with the rest; says which cell.
    """
    cells = []
    checked: dict[tuple[object, ...], float | None] = {}
    recorded: dict[tuple[object, ...], Sequence[Trajectory]] = {}
    for one in combinations:
        try:
            cells.append(_cell(one, checked, recorded))
        except UsageError as error:
            raise UsageError(f"{one.where or one.name}: {error}") from error
    return cells


def _cell(
    one: Combination,
    checked: dict[tuple[object, ...], float | None],
    recorded: dict[tuple[object, ...], Sequence[Trajectory]],
) -> Cell:
    values = one.values
    scenario = scenario_for(one.scenario, values["safe"], one.changes)
    graph = bool(values["graph"])
    car = CarUnderTest(values["controller"], values["multiplier"])
    # To make a user's controller takes a process and all that its module imports: once for those that are alike.
    alike = (
        car, graph, values["simulator"], scenario.time_step, scenario.control_period, scenario.sensor is None,
        *(values[option.name] for option in options_of(GraphOptions)),
    )  # fmt: skip
    if alike not in checked:
        checked[alike] = check_car(values, scenario, graph=graph).control_period
    scenario = replace(scenario, control_period=checked[alike])
    plan = plan_of(values, scenario)
    objectives = objectives_named(values["objective"])
    make_simulator(plan.simulator)
    safe: Sequence[Trajectory] | None = None
    if plan.safe not in GENERATED:
        source = (plan.safe, plan.safe_count, str(scenario.as_dict()))
        if source not in recorded:
            recorded[source] = safe_trajectories(plan, InProcessRunner(1))
        safe = recorded[source]
    if values["curve"] and graph:
        raise UsageError("curve goes with assessments in process: leave out graph")
    risk = risk_request(values["behaviour"], values["risk_runs"], subset=values["risk_subset"])
    files = _files_of(plan, objectives, values["controller_command"] or "")
    requested = {"objectives": objectives, "risk": risk, **{key: values[key] for key in ("margin_limit", "curve")}}
    return Cell(
        one.name,
        plan,
        requested,
        GraphOptions(**values_of(GraphOptions, values)) if graph else None,
        values["startup_timeout"],
        one.swept,
        _identity(one, plan, objectives, safe, risk, files),
        one.where,
    )


def _files_of(plan: Plan, objectives: Sequence[Objective], command: str) -> dict[str, str] | None:
    """Return the files of a car, and of plug-ins by which it is rated."""
    others = [SIMULATORS.target(plan.simulator)] if plan.simulator not in SIMULATORS.own else []
    others += [OBJECTIVES.target(str(name)) for name in objectives if name not in OBJECTIVES.own]
    return code_digests(plan.car, command, others)


def _identity(
    one: Combination,
    plan: Plan,
    objectives: Sequence[Objective],
    safe: Sequence[Trajectory] | None,
    risk: RiskRequest,
    files: dict[str, str] | None,
) -> dict[str, Any]:
    """Return all that the figures of a cell depend on."""
    values = one.values
    options = {option.name: option.plain(getattr(plan, option.name)) for option in options_of(CampaignOptions)}
    del options["name"]  # no figure depends on it
    options["objective"] = ",".join(objectives)
    options["car_model"] = hashlib.sha256(plan.car_model.encode()).hexdigest() if plan.car_model else ""
    further = ["graph", "margin_limit", "curve"]
    if values["graph"]:  # else these are of no effect
        further += [option.name for option in options_of(GraphOptions) if option.name not in OF_NO_RESULT]
    given = {name: values[name] for name in further}
    return {
        **options,
        **{name: list(value) if isinstance(value, tuple) else value for name, value in given.items()},
        "behaviour": None if risk.behaviour is None else risk.behaviour.as_dict(),
        "risk": [risk.runs, risk.subset],
        "scenario": plan.scenario.as_dict(),
        "safe_trajectories": None if safe is None else [digest_of_trajectory(phi).hex() for phi in safe],
        "file": files,
        "environment": dict(environment()),
    }


FIGURES = columns("campaign")
OF_PLANS = ("adversary_model", "ranking_objective")
"""Of a row: by whom its planned figures are."""
FIRST = ("name", "state", "controller", "multiplier", "scenario", "safe", "seed")
CHECKED = (ASSESSMENT, EPISODES)
OPEN, DONE, FAILED = "open", "done", "failed"

Row = dict[str, Any]


def open_row(cell: Cell) -> Row:
    """Return the row of a cell that is to be run."""
    plan = cell.plan
    return {
        "name": cell.name,
        "state": OPEN,
        "controller": plan.controller,
        "multiplier": plan.car.stated_multiplier,
        "scenario": plan.scenario.name,
        "safe": plan.safe,
        "seed": plan.seed,
        **{f"sweep.{key}": value for key, value in cell.swept.items() if key not in FIRST},
        "episodes": None,
        **dict.fromkeys((*OF_PLANS, *FIGURES)),
        "equivalent_multiplier_note": "",
        "problems": [],
        "warnings": [],
        "sha256": {},
    }


def done_row(cell: Cell, assessment: Assessment, *, maximum_aborted: float, digests: Mapping[str, str]) -> Row:
    """Return the row of a cell that is done.

    Args:
        cell: the cell that is done.
        assessment: its figures.
        maximum_aborted: share of its episodes that may be aborted.
        digests: SHA-256 of the files that hold its result.
    """
    figures = assessment.as_dict()
    return {
        **open_row(cell),
        "state": DONE,
        **{name: figures[name] for name in FIGURES},
        "adversary_model": str(figures["adversary_model"]),
        "ranking_objective": str(assessment.for_deviation.plan.objective),
        "equivalent_multiplier_note": figures["equivalent_multiplier_note"],
        "episodes": assessment.episodes,
        "problems": why_failed(assessment, maximum_aborted, figures),
        "warnings": warnings_of(assessment),
        "sha256": dict(digests),
    }


def planned_rows(cells: Sequence[Cell]) -> list[Row]:
    """Return what is requested, cell by cell, and how many episodes that takes."""
    return [
        {
            **{key: value for key, value in open_row(cell).items() if key in FIRST or key.startswith("sweep.")},
            "graph": cell.graph is not None,
            "episodes": cell.episodes(),
            "most": cell.episodes(TRIALS_PER_REQUESTED),
        }
        for cell in cells
    ]
