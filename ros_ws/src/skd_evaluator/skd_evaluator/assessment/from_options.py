"""Scenario, car and plan of options, and the files that options name; what does not go together is refused."""

from __future__ import annotations

import csv
import datetime
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from skd_adversary.car_models.car_model_file import car_model_for_scenario, file_of
from skd_adversary.safe_trajectories.sources import count_safe_trajectories, is_citr
from skd_sim.errors import UsageError
from skd_sim.inputs.files import from_here, real_path
from skd_sim.options.car_and_adversary import (
    AdversaryModel,
    CarUnderTest,
    check_adversary_model,
    default_adversary_model,
    objectives_named,
)
from skd_sim.options.options import EXTERNAL, GRAPH, options_of, values_of
from skd_sim.scenario.scenario import Scenario, changed_scenario, check_control_period, load_scenario
from skd_sim.scenario.scenario_file import REGULATORY, SCENARIOS, is_named, lineage

from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.assessment.options import GENERATED, NO_BEHAVIOUR, OWN, SYNTHETIC, CampaignOptions, GraphOptions
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import check_controller
from skd_evaluator.metrics.behaviour import WALKERS
from skd_evaluator.provenance import code_paths


def scenario_for(name: str | None, safe: str, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Return the scenario asked for, or the one that goes with the safe trajectories, with some keys changed.

    Args:
        name: or path of the scenario asked for, if one is.
        safe: source of the safe trajectories.
        changes: values of keys by their place in its file, as car.start_speed.

    Raises:
        UsageError: there is no such scenario, or with these values it is none.
    """
    source = name or ("citr_crossing" if safe not in GENERATED and is_citr(safe) else "crossing")
    return changed_scenario(source, changes) if changes else load_scenario(source)


def with_requested_period(scenario: Scenario, period: float | None) -> Scenario:
    """Return the scenario with the control period (s) that is asked for, if one is.

    Raises:
        UsageError: the period does not divide the scenario's time step.
    """
    if period is None:
        return scenario
    changed = replace(scenario, control_period=period)
    check_control_period(changed, f"control_period in scenario {scenario.name}")
    return changed


def check_car(values: Mapping[str, Any], scenario: Scenario, *, graph: bool) -> Scenario:
    """Refuse, before any work, an unknown controller, or options or a scenario that do not go with it.

    Args:
        values: values of the options of an episode and of the graph, as the command line has them.
        scenario: the scenario of the test.
        graph: whether episodes run through the node graph.

    Returns:
        The scenario with the control period that the controller declares, or that is asked for, if so.
    """
    car = CarUnderTest(values["controller"], values["multiplier"])
    for one in options_of(GraphOptions):
        if values.get(one.name, one.unsaid) == one.unsaid:
            continue
        if EXTERNAL in one.marks and not car.is_external:
            own = "; a Python class has the attribute control_period" if one.name == "control_period" else ""
            raise UsageError(f"{one.flag} goes with --controller external{own}")
        if GRAPH in one.marks and not graph:
            raise UsageError(f"{one.flag} is for the node graph: add --graph")
    if not car.has_multiplier and car.multiplier != CarUnderTest.multiplier:
        raise UsageError(f"--multiplier is C of the basic controller; {car.controller} has none: leave it out")
    simulator = values.get("simulator")
    if car.kind.simulator and (graph or simulator != car.kind.simulator):
        instead = "leave out --graph" if simulator == car.kind.simulator else f"add --simulator {car.kind.simulator}"
        if simulator is None:  # the command has no such option
            instead = f"skd assess --simulator {car.kind.simulator} runs it"
        raise UsageError(f"--controller {car.controller} decides within simulator {car.kind.simulator}: {instead}")
    if not car.is_external:
        scenario = check_controller(car, scenario)
    elif not graph:
        how = "add --graph" if "graph" in values else "skd assess --graph runs it"
        raise UsageError(f"--controller external needs the node graph: {how}")
    else:
        scenario = with_requested_period(scenario, values["control_period"])
    if graph:
        GraphOptions(**values_of(GraphOptions, values)).check(car)
    return scenario


def plan_of(values: Mapping[str, Any], scenario: Scenario, **fixed: Any) -> Plan:
    """Return the plan that options of the command line or parameters of the node ask for, of their last objective.

    Args:
        values: values by name of the option; values of other options are passed over.
        scenario: the scenario of the test.
        fixed: options that the command decides for itself.
    """
    plain = {**values, **fixed}
    plain["objective"] = objectives_named(plain["objective"])[-1]
    if plain.get("safe") == REGULATORY and plain["safe_count"] == CampaignOptions.safe_count:
        # Unless a number is asked for: all that the protocol has.
        plain["safe_count"] = min(plain["safe_count"], count_safe_trajectories(REGULATORY, scenario))
    controller = plain.get("controller", CampaignOptions.controller)  # a sweep has basic cars only
    car, model = CarUnderTest(controller, plain["multiplier"]), bool(plain["car_model"])
    if car.is_external and not plain.get("name"):
        plain["name"] = name_of_command(plain.get("controller_command") or "")
    requested = plain.get("adversary_model")
    known = AdversaryModel(requested) if requested else default_adversary_model(car, plain["car_model"])
    check_adversary_model(known, car, model=model)
    plain["adversary_model"] = str(known)
    if model:
        source = Path(plain["car_model"]).expanduser()
        plain["car_model"] = car_model_for_scenario(source, scenario)
        check_unchanged(file_of(source).parent, [file_of(source).name])
    return Plan(scenario, **values_of(CampaignOptions, plain))


_STARTERS = ("bash", "sh", "env", "exec", "python", "python3", "ros2", "run", "launch", "source", "docker", "sudo")
"""Words of a command that start something else, which is told by its name."""


def name_of_command(command: str) -> str:
    """Return the name of a stack by the command that starts it: package and program of ros2, else file or program."""
    try:
        words = [one for word in shlex.split(command) for one in word.split()]  # a shell's command is one word
    except ValueError:  # a quotation mark too many: it will not start either
        return ""
    for verb in ("run", "launch"):
        if "ros2" in words and words[words.index("ros2") + 1 : words.index("ros2") + 2] == [verb]:
            named = [word for word in words[words.index("ros2") + 2 :] if not word.startswith("-")][:2]
            return "/".join(Path(word).name for word in named if ":=" not in word)
    named = [word for word in words if not word.startswith("-") and "=" not in word]
    return next((Path(word).name for word in named if Path(word).name not in _STARTERS), "")


def default_folder(task: str) -> Path:
    """Return a new folder named for the task and the time."""
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
    return Path("skd_results") / f"{task}-{stamp}"


_WRITTEN = ("out", "junit", "markdown")
"""Options that name what is written."""
_WORDS = (None, "", SYNTHETIC, OWN, REGULATORY, WALKERS, NO_BEHAVIOUR)
"""Values that name no file where a path is expected."""


def inputs_of(values: Mapping[str, Any]) -> list[Path]:
    """Return the files and folders that options name to be read, whether they are there or not.

    A node's own command line is no such option: what it reads is not known.

    Args:
        values: values of options by name, of the command line, of a campaign's cell or of the evaluator's node.
    """
    found = [one for name, value in values.items() if name not in _WRITTEN for one in _paths(value)]
    if values.get("safe") not in _WORDS:
        found.append(Path(str(values["safe"])))
    models = [values.get(name) for name in ("car_model", "behaviour", "warm_start")]
    found += [_expanded(str(name)) for name in models if name not in _WORDS]
    found += map(_expanded, values.get("message_folder") or ())
    scenarios = [values.get("scenario"), *(values.get("names") or ())]
    if isinstance(listed := values.get("scenarios"), str):
        scenarios += [name.strip() for row in csv.reader([listed]) for name in row]
    found += [path for name in scenarios if name for path in _files_of_scenario(str(name))]
    if values.get("controller"):
        found += code_paths(CarUnderTest(str(values["controller"])))
    return list(dict.fromkeys(found))


def refuse_to_replace(out: Path, paths: Iterable[Path], option: str = "--out") -> None:
    """Refuse an output that is, or holds, what is read: it would be replaced.

    Args:
        out: where the file is to be, or the folder.
        paths: what is read.
        option: the option that names the output, for error lines.

    Raises:
        UsageError: it is so.
    """
    for path in (one for one in paths if lies_in(one, out)):
        if out.is_file():
            raise UsageError(f"{option} {out}: is read by this command; give another file")
        raise UsageError(f"{option} {out}: holds {from_here(str(path))}, which this command reads; give another folder")


def lies_in(path: Path, folder: Path) -> bool:
    """Return whether a path leads into a folder, whatever links lead there."""
    try:
        return real_path(path).is_relative_to(real_path(folder))
    except ValueError:  # a name with a zero in it leads nowhere
        return False


def _paths(value: Any) -> Iterator[Path]:
    """Yield the paths in a value of an option."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, (list, tuple)):
        yield from (one for one in value if isinstance(one, Path))


def _expanded(name: str) -> Path:
    try:
        return Path(name).expanduser()
    except RuntimeError:  # of a home that is not there
        return Path(name)


def _files_of_scenario(name: str) -> list[Path]:
    """Return a scenario's file, if it has one, and those of the scenarios that it builds upon."""
    try:
        sources = lineage(name)
    except UsageError:  # it cannot be read, which is said elsewhere, or is a result
        sources = [name]
    files = (one for one in sources if one not in SCENARIOS.own)
    return [Path(one) for one in files if Path(one).is_file() or not is_named(one)]
