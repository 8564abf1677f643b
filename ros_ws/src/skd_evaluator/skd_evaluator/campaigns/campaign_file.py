"""The file of a campaign: which cars, encounters and values are crossed, each key checked where it stands.

    defaults: {kamikaze_count: 50}
    cars:
      - {controller: basic, sweep: {multiplier: [0.75, 1.0]}}
      - controller: cal
    encounters:
      - scenario: crossing
    sweep:
      seed: [0, 1]

Every entry holds options by their names in `CampaignOptions` and, for the node graph, `GraphOptions`; what is to be
computed beside; and `scenario.…`, keys of the scenario's own file. docs/campaigns.md.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skd_adversary.safe_trajectories import REGULATORY
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.options import Option, options_of
from skd_sim.encounter.known_scenarios import SCENARIOS, is_named
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import is_there
from skd_sim.inputs.suggestion import did_you_mean
from skd_sim.inputs.yaml_file import name_of_key, parse_yaml, read_text, short

from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.campaign.plan.options import (
    BEHAVIOUR_TEXT,
    DEFAULT_MARGIN_LIMIT,
    MARGIN_LIMIT_TEXT,
    NO_BEHAVIOUR,
    OWN,
    RISK_RUNS_TEXT,
    RISK_SUBSET_TEXT,
    SYNTHETIC,
    WALKERS,
    CampaignOptions,
)

MOST_CELLS = 10_000
_CAMPAIGN = {one.name: one for one in options_of(CampaignOptions)}
_GRAPH = {one.name: one for one in options_of(GraphOptions) if one.name != "graphs"}  # of the whole campaign
_FURTHER = {
    "graph": Option("whether episodes run through the node graph", kind=bool, name="graph", default=False),
    "margin_limit": Option(
        MARGIN_LIMIT_TEXT, low=0, high=10_000_000, kind=int, name="margin_limit", default=DEFAULT_MARGIN_LIMIT
    ),
    "behaviour": Option(BEHAVIOUR_TEXT, kind=str, name="behaviour", default=WALKERS),
    "risk_runs": Option(RISK_RUNS_TEXT, low=1, high=10_000_000, kind=int, name="risk_runs", default=None),
    "risk_subset": Option(RISK_SUBSET_TEXT, kind=bool, name="risk_subset", default=False),
    "curve": Option("whether kamikazes are held to largest deformations too", kind=bool, name="curve", default=False),
}
_OPTIONS = {**_CAMPAIGN, **_GRAPH, **_FURTHER}
_OF_FILES = ("safe", "car_model", "message_folder", "behaviour")
_OF_CAR = ("controller", "multiplier")
_SCENARIO = "scenario"
_ENTRY, _SECTIONS = ("name", "sweep"), ("defaults", "cars", "encounters", "sweep")
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


def read_campaign(path: Path) -> list[Combination]:
    """Return the cells of a campaign's file, in its order: car by car, encounter by encounter, value by value.

    Raises:
        UsageError: it cannot be read, or something in it is wrong; says where.
    """
    try:
        text = read_text(path)
    except OSError as error:
        raise UsageError(f"campaign {path}: cannot be read ({error.strerror or error})") from error
    reader = _Reader(path)
    data = reader.mapping(parse_yaml(text, str(path)), "the file")
    reader.known(data, _SECTIONS, "")
    defaults = reader.values(reader.mapping(data.get("defaults", {}), "defaults"), "defaults")
    cars = reader.entries(data.get("cars", [{}]), "cars", defaults)
    encounters = reader.entries(data["encounters"], "encounters", {}) if "encounters" in data else [_Part({})]
    sweeps = reader.sweeps(data.get("sweep", {}), "sweep")
    reader.refuse_repeated({"cars": cars, "encounters": encounters, "sweep": sweeps})
    if (count := len(cars) * len(encounters) * len(sweeps)) > MOST_CELLS:
        raise UsageError(f"{path}: {count} cells; at most {MOST_CELLS} go into a campaign")
    cells = [_cell(defaults, parts) for parts in itertools.product(cars, encounters, sweeps)]
    return list(_with_unique_names(cells, path))


class _Reader:
    """Checks what a file says."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def mapping(self, data: Any, where: str) -> Mapping[str, Any]:
        if not isinstance(data, Mapping):
            raise UsageError(f"{self._path}: {where} must be a mapping, got {type(data).__name__}")
        return data

    def known(self, data: Mapping[str, Any], allowed: Sequence[str], prefix: str) -> None:
        for key in data:
            if key not in allowed:
                name = name_of_key(key)
                raise UsageError(
                    f"{self._path}: unknown key {prefix}{name}; allowed: {', '.join(allowed)}"
                    f"{did_you_mean(name, allowed)}"
                )

    def entries(self, data: Any, section: str, defaults: Mapping[str, Any]) -> list[_Part]:
        """Return the ways to go through all entries of a section."""
        if not isinstance(data, Sequence) or isinstance(data, str) or not data:
            raise UsageError(f"{self._path}: {section} must be a list of at least one entry")
        found = []
        for index, item in enumerate(data):
            where = f"{section}[{index}]"
            entry = self.mapping(item, where)
            name = entry.get("name", "")
            if not isinstance(name, str) or (name and not _UNSAFE.sub("", name)):
                raise UsageError(f"{self._path}: {where}.name must be text, got {short(name)}")
            own = {key: value for key, value in entry.items() if key not in _ENTRY}
            values = self.values(own, where)
            sweeps = self.sweeps(entry.get("sweep", {}), f"{where}.sweep")
            self.refuse_repeated({where: [_Part(values)], f"{where}.sweep": sweeps})
            for one in sweeps:
                found.append(_Part({**values, **one.values}, one.swept, name, f"{self._path}: {where}"))
        return found

    def sweeps(self, data: Any, where: str) -> list[_Part]:
        """Return every combination of the values of some keys."""
        lists: dict[str, list[Any]] = {}
        for key, values in self.mapping(data, where).items():
            if not isinstance(values, list) or not values:
                raise UsageError(f"{self._path}: {where}.{name_of_key(key)} must be a list of values")
            lists[key] = [self.values({key: value}, where, f"[{index}]")[key] for index, value in enumerate(values)]
            texts = [repr(value) for value in lists[key]]
            if len(set(texts)) < len(texts):
                raise UsageError(f"{self._path}: {where}.{key}: a value is given twice")
        if math.prod(map(len, lists.values())) > MOST_CELLS:
            raise UsageError(f"{self._path}: {where}: more than {MOST_CELLS} combinations")
        return [_Part(dict(zip(lists, row, strict=True)), tuple(lists)) for row in itertools.product(*lists.values())]

    def values(self, data: Mapping[str, Any], where: str, index: str = "") -> dict[str, Any]:
        """Return options, with paths as seen from the current folder; `index` is that in a list of values."""
        changes = [key for key in data if isinstance(key, str) and key.startswith(f"{_SCENARIO}.")]
        self.known(data, (*_OPTIONS, _SCENARIO, *changes), f"{where}.")
        found = dict(data)
        for key, value in data.items():
            what = f"{self._path}: {where}.{key}{index}"
            if key in changes:
                continue  # the scenario's own reader checks them
            if key == _SCENARIO:
                if not isinstance(value, str):
                    raise UsageError(
                        f"{what} must be the name or the file of a scenario; to set a key of it write scenario.KEY"
                    )
                is_file = is_there(self._beside(value)) and self._beside(value).is_file()
                if not is_file and not is_named(value):
                    raise UsageError(
                        f"{what}: {short(value)} is no file beside this one, nor one of: {', '.join(SCENARIOS.names())}"
                        f"{did_you_mean(value, SCENARIOS.names())}"
                    )
                found[key] = self._path_of(value) if is_file else value
            elif value is None:
                found[key] = _OPTIONS[key].unsaid
            elif _OPTIONS[key].many:
                found[key] = tuple(self._path_of(one) for one in self._texts(value, what))
            else:
                _OPTIONS[key].check(value, what)
                is_path = key in _OF_FILES and value not in ("", SYNTHETIC, OWN, REGULATORY, WALKERS, NO_BEHAVIOUR)
                found[key] = self._path_of(value) if is_path else _OPTIONS[key].kind(value)
        return found

    def _texts(self, value: Any, what: str) -> list[str]:
        texts = value if isinstance(value, list) else [value]
        if not all(isinstance(one, str) for one in texts):
            raise UsageError(f"{what} must be text, or a list of texts, got {short(value)}")
        return texts

    def _beside(self, name: str) -> Path:
        try:
            return self._path.parent / Path(name).expanduser()
        except RuntimeError as error:
            raise UsageError(f"{self._path}: {name[:60]!r}: nobody knows that home; write the path out") from error

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


def _cell(defaults: Mapping[str, Any], parts: tuple[_Part, _Part, _Part]) -> Combination:
    car, encounter, sweep = parts
    given = {**defaults, **car.values, **encounter.values, **sweep.values}
    values = {one.name: one.unsaid for one in (*_OPTIONS.values(), *options_of(GraphOptions))}
    values |= {key: value for key, value in given.items() if key in values}
    changes = {key.partition(".")[2]: value for key, value in given.items() if key.startswith(f"{_SCENARIO}.")}
    scenario = given.get(_SCENARIO)
    swept = {key: given[key] for part in parts for key in part.swept}
    words = [car.name or CarUnderTest(values["controller"], values["multiplier"]).file_name]
    shown = () if car.name else _OF_CAR  # they are in the name of the car
    words += [_word(key, given[key]) for key in car.swept if key not in shown]
    if encounter.where:
        words.append(encounter.name or (_stem(scenario) if scenario else _stem(str(values["safe"]))))
    words += [_word(key, given[key]) for part in (encounter, sweep) for key in part.swept if key not in shown]
    name = _UNSAFE.sub("-", "_".join(words)).strip(".-_")
    return Combination(name, values, scenario, changes, swept, car.where or encounter.where)


def _word(key: str, value: Any) -> str:
    """Return what a swept value is called in the name of its cell."""
    if isinstance(value, float):
        text = f"{value:.12g}"
    elif key in (*_OF_FILES, _SCENARIO):
        text = _stem(str(value))
    else:
        text = str(value)
    return f"{key.rpartition('.')[2]}={text}"


def _stem(path: str) -> str:
    return Path(path).stem


def _with_unique_names(cells: Sequence[Combination], path: Path) -> Iterator[Combination]:
    taken: dict[str, Combination] = {}
    for cell in cells:
        other = taken.setdefault(cell.name.lower(), cell)  # some file systems know no case
        if other is not cell:
            raise UsageError(f"{path}: two cells are called {cell.name}; give their entries a name: of their own")
        if len(cell.name) > _LONGEST_NAME or not cell.name:
            raise UsageError(f"{path}: {cell.name:.60}… is too long for a folder; give its entries a shorter name:")
        yield cell
