"""The file of a campaign, which crosses cars, scenarios and values, each key checked where it stands; and its cells.

    defaults: {kamikaze_count: 50}
    cars:
      - {controller: basic, sweep: {multiplier: [0.75, 1.0]}}
      - controller: cal
    scenarios:
      - scenario: crossing
    sweep:
      seed: [0, 1]

Every entry holds options by their names in `CampaignOptions` and, for the node graph, `GraphOptions`; what is to be
computed beside; and `scenario.…`, keys of the scenario's own file. docs/campaigns.md.

A cell is one assessment that is ready to run, all that its figures depend on, and its row: what campaign.json says of
it, with the SHA-256 of the files of its result.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, is_there
from skd_sim.inputs.model import Frozen, read_model
from skd_sim.inputs.yaml_file import read_yaml, short
from skd_sim.options.car_and_adversary import OBJECTIVES, SIMULATORS, CarUnderTest, Objective, objectives_named
from skd_sim.options.options import option, options_of, read_options, values_of
from skd_sim.scenario.scenario_file import REGULATORY, SCENARIOS, is_named
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment import options as tables
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import RiskRequest
from skd_evaluator.assessment.figure_table import columns
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.episode_store import digest_of, digest_of_trajectory
from skd_evaluator.assessment.files.episodes_npz import EPISODES
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.options import GENERATED, OWN, SYNTHETIC, WALKERS, CampaignOptions, GraphOptions
from skd_evaluator.assessment.plan import TRIALS_PER_REQUESTED, Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.kamikazes import BOUNDS, bounded_trials
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.provenance import code_digests, environment
from skd_evaluator.report.warnings import warnings_of, why_failed

MOST_CELLS = 10_000
_SCENARIO = "scenario"


@dataclass(frozen=True)
class _CellOptions:
    """The table of what a cell has beside the options of an assessment."""

    graph: bool = option(False, "whether episodes run through the node graph")
    scenario: str | None = option(None, "name or file of the scenario", str)


_TABLES = (CampaignOptions, GraphOptions, tables.AssessmentOptions, _CellOptions)
_OPTIONS = {one.name: one for table in _TABLES for one in options_of(table)}
_OF_FILES = ("safe", "car_model", "message_folder", "behaviour")
_NAMED = ("", SYNTHETIC, OWN, REGULATORY, WALKERS, tables.NO_BEHAVIOUR)
"""Values of those that are no file."""
_OF_CAR = ("controller", "multiplier")
_Lists = dict[str, Annotated[list[Any], Field(min_length=1)]]
_Entries = Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]


@dataclass(frozen=True)
class _CampaignFile(Frozen):
    """The sections of a campaign's file."""

    defaults: dict[str, Any] = field(default_factory=dict)
    cars: _Entries = ({},)
    scenarios: _Entries | None = None
    sweep: _Lists = field(default_factory=dict)


@dataclass(frozen=True)
class _Entry(Frozen):
    """What an entry has beside options."""

    name: str = ""
    sweep: _Lists = field(default_factory=dict)


_UNSAFE = re.compile(r"[^\w.+=-]+", re.ASCII)
_LONGEST_NAME = 150


@dataclass(frozen=True)
class Combination:
    """One cell as the file has it.

    Attributes:
        name: readable, unique, and fit for a folder.
        values: value of every option, as the command line has them.
        scenario: name or path; none: that which goes with the safe trajectories.
        changes: values of keys of the scenario, by their place in it.
        swept: the swept values, by key.
        where: the cell's place in the file, for error lines.
    """

    name: str
    values: Mapping[str, Any]
    scenario: str | None
    changes: Mapping[str, Any]
    swept: Mapping[str, Any]
    where: str


@dataclass(frozen=True)
class _Part:
    """One way to go through an entry: its values, those of them that are swept, and what it is called."""

    values: Mapping[str, Any]
    swept: tuple[str, ...] = ()
    name: str = ""
    where: str = ""


def read_campaign(path: Path, further: Sequence[Mapping[str, Any]] = ()) -> list[Combination]:
    """Return the cells of a campaign's file, in its order: car by car, scenario by scenario, value by value.

    Args:
        path: the file.
        further: entries of more cars.

    Raises:
        UsageError: it cannot be read, or something in it is wrong; says where.
    """
    reader = _Reader(path)
    file = read_model(_CampaignFile, read_yaml(path), str(path))
    defaults = reader.values(file.defaults, "defaults")
    cars = reader.entries(file.cars, "cars")
    cars += [replace(one, where="") for one in reader.entries(further, "cars")]  # no place in the file
    scenarios = [_Part({})] if file.scenarios is None else reader.entries(file.scenarios, "scenarios")
    sweeps = reader.sweeps(file.sweep, "sweep")
    reader.refuse_repeated({"cars": cars, "scenarios": scenarios, "sweep": sweeps})
    if (count := len(cars) * len(scenarios) * len(sweeps)) > MOST_CELLS:
        raise UsageError(f"{path}: {count} cells; at most {MOST_CELLS} go into a campaign")
    cells = [_combination(defaults, parts) for parts in itertools.product(cars, scenarios, sweeps)]
    return list(_with_unique_names(cells, path))


class _Reader:
    """Checks what a file says."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def entries(self, entries: Sequence[Mapping[str, Any]], section: str) -> list[_Part]:
        """Return the ways to go through all entries of a section."""
        found = []
        for index, item in enumerate(entries):
            where = f"{section}[{index}]"
            own = {key: value for key, value in item.items() if key not in ("name", "sweep")}
            entry = read_model(_Entry, {key: item[key] for key in item if key not in own}, str(self._path), where)
            if entry.name and not _UNSAFE.sub("", entry.name):
                raise UsageError(f"{self._path}: {where}.name: no folder can be called {short(entry.name)}")
            values, sweeps = self.values(own, where), self.sweeps(entry.sweep, f"{where}.sweep")
            self.refuse_repeated({where: [_Part(values)], f"{where}.sweep": sweeps})
            found += [
                _Part({**values, **one.values}, one.swept, entry.name, f"{self._path}: {where}") for one in sweeps
            ]
        return found

    def sweeps(self, data: Mapping[str, list[Any]], where: str) -> list[_Part]:
        """Return every combination of the values of some keys."""
        lists = self.values(data, where, listed=True)
        for key, values in lists.items():
            texts = [repr(value) for value in values]
            if len(set(texts)) < len(texts):
                raise UsageError(f"{self._path}: {where}.{key}: a value is given twice")
        if math.prod(map(len, lists.values())) > MOST_CELLS:
            raise UsageError(f"{self._path}: {where}: more than {MOST_CELLS} combinations")
        return [_Part(dict(zip(lists, row, strict=True)), tuple(lists)) for row in itertools.product(*lists.values())]

    def values(self, data: Mapping[str, Any], where: str, *, listed: bool = False) -> dict[str, Any]:
        """Return options, with paths as seen from the current folder; with `listed` there is a list of values of each.

        Keys of the scenario are left to its own reader.
        """
        changes = {key for key in data if key.startswith(f"{_SCENARIO}.")}
        options = {key: value for key, value in data.items() if key not in changes}
        if "name" in options:
            raise UsageError(f"{self._path}: unknown key {where}.name: an entry of cars has a name")
        read = read_options(options, str(self._path), *_TABLES, path=where, listed=listed)
        found = {key: data[key] if key in changes else read[key] for key in data}
        for key in read:
            what = f"{self._path}: {where}.{key}"
            found[key] = (
                [self._value(key, one, what) for one in read[key]] if listed else self._value(key, read[key], what)
            )
        return found

    def _value(self, key: str, value: Any, what: str) -> Any:
        if value is None:
            return _OPTIONS[key].unsaid
        if key == _SCENARIO:
            return self._scenario(value, what)
        if isinstance(value, tuple):
            return tuple(map(self._path_of, value))
        is_file = (key in _OF_FILES and value not in _NAMED) or (key == "controller" and ".py:" in value)
        return self._path_of(value) if is_file else value

    def _scenario(self, value: str, what: str) -> str:
        """Return the name of a scenario, or the path of its file, which may be beside the campaign's."""
        if is_there(self._beside(value)) and self._beside(value).is_file():
            return self._path_of(value)
        if not is_named(value):
            names = SCENARIOS.names()
            hint = f"{', '.join(names)}{did_you_mean(value, names)}"
            raise UsageError(f"{what}: {short(value)} is no file beside this one, nor one of: {hint}")
        return value

    def _beside(self, name: str) -> Path:
        try:
            return self._path.parent / Path(name).expanduser()
        except RuntimeError as error:
            raise UsageError(f"{self._path}: {name[:60]!r}: there is no such home; write the path out") from error

    def _path_of(self, name: str) -> str:
        """Return a path that the file has, which is relative to the folder of the file."""
        return str(self._beside(name))

    def refuse_repeated(self, sections: Mapping[str, Sequence[_Part]]) -> None:
        """Refuse a key that two sections set, for one of them would be of no effect."""
        owner: dict[str, str] = {}
        for section, parts in sections.items():
            for key in dict.fromkeys(key for part in parts for key in part.values):
                if owner.setdefault(key, section) != section:
                    raise UsageError(f"{self._path}: {key} is set in {owner[key]} and in {section}; leave one out")


def _combination(defaults: Mapping[str, Any], parts: tuple[_Part, _Part, _Part]) -> Combination:
    car, of_scenario, sweep = parts
    given = {**defaults, **car.values, **of_scenario.values, **sweep.values}
    values = {name: one.unsaid for name, one in _OPTIONS.items() if name != _SCENARIO}
    values |= {key: value for key, value in given.items() if key in values}
    changes = {key.partition(".")[2]: value for key, value in given.items() if key.startswith(f"{_SCENARIO}.")}
    scenario = given.get(_SCENARIO)
    swept = {key: given[key] for part in parts for key in part.swept}
    words = [car.name or CarUnderTest(values["controller"], values["multiplier"]).file_name]
    shown = () if car.name else _OF_CAR  # they are in the name of the car
    words += [_word(key, given[key]) for key in car.swept if key not in shown]
    if of_scenario.where:
        words.append(of_scenario.name or Path(scenario or str(values["safe"])).stem)
    words += [_word(key, given[key]) for part in (of_scenario, sweep) for key in part.swept if key not in shown]
    if car.name:
        values["name"] = ", ".join([car.name, *(_word(key, given[key]) for key in car.swept)])
    name = _UNSAFE.sub("-", "_".join(words)).strip(".-_")
    return Combination(name, values, scenario, changes, swept, car.where or of_scenario.where)


def _word(key: str, value: Any) -> str:
    """Return what a swept value is called in the name of its cell."""
    if isinstance(value, float):
        text = f"{value:.12g}"
    elif key in (*_OF_FILES, _SCENARIO):
        text = Path(str(value)).stem
    else:
        text = str(value)
    return f"{key.rpartition('.')[2]}={text}"


def _with_unique_names(cells: Sequence[Combination], path: Path) -> Iterator[Combination]:
    taken: dict[str, Combination] = {}
    for cell in cells:
        other = taken.setdefault(cell.name.lower(), cell)  # some file systems know no case
        if other is not cell:
            raise UsageError(f"{path}: two cells are called {cell.name}; give their entries a name: of their own")
        if len(cell.name) > _LONGEST_NAME or not cell.name:
            raise UsageError(f"{path}: {cell.name:.60}… is too long for a folder; give its entries a shorter name:")
        yield cell


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
        further += [option.name for option in options_of(GraphOptions) if option.name not in tables.OF_NO_RESULT]
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
