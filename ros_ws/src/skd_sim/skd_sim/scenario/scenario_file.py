"""Content of a scenario's file: found by name or by path, and built upon others. Light: completion begins with it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, is_there
from skd_sim.inputs.yaml_file import parse_yaml, read_yaml
from skd_sim.options.registry import Registry

_FOLDER = resources.files("skd_sim") / "scenarios"


def shipped_scenarios() -> list[str]:
    """Return the names of the scenarios that come with SKD."""
    return sorted(entry.name.removesuffix(".yaml") for entry in _FOLDER.iterdir() if entry.name.endswith(".yaml"))


SCENARIOS = Registry("scenario", "skd.scenarios", {name: f"skd_sim.scenarios:{name}" for name in shipped_scenarios()})
"""SKD's own are files of a folder. An entry point leads to a path of a YAML file, or to a mapping with its keys."""


REGULATORY = "regulatory"
"""Source of safe trajectories: what a scenario's section `protocol` prescribes for a test's target, one a place."""
_AT_PLACE = re.compile(r"(.+?)-(-?\d+)")
_EXTENDS = "extends"


def is_named(source: str) -> bool:
    """Tell whether a source is the name of a scenario, with an impact place or without; no file is opened."""
    at_place = _AT_PLACE.fullmatch(source)
    return source in SCENARIOS or (at_place is not None and at_place[1] in SCENARIOS)


def scenario_data(source: str) -> Any:
    """Return the content of a scenario: a shipped one, one of an installed package, or a YAML file.

    A file that `extends` another scenario, by its name or its path beside it, has all of that one's keys but those that
    it gives itself; a key of null is as if it were not given. The name of a scenario with a section `protocol` may be
    followed by one of its impact places, as in `cpna-75`.

    Args:
        source: name of the scenario, or path of its file.

    Raises:
        UsageError: there is no such scenario, or it is no YAML.
    """
    return _extended(source, ())


def _extended(source: str, before: tuple[str, ...]) -> Any:
    data = _own_data(source, before)
    if not isinstance(data, Mapping) or _EXTENDS not in data:
        return data
    base = _base_of(data, source)
    if base in (*before, source):
        raise UsageError(f"{source}: {_EXTENDS} leads back to {base}: a scenario cannot build upon itself")
    try:
        found = _extended(base, (*before, source))
    except UsageError as error:
        raise error if before else UsageError(f"{source}: {_EXTENDS}: {error}") from error
    return _merged(found, {key: value for key, value in data.items() if key != _EXTENDS})


def _base_of(data: Mapping[str, Any], source: str) -> str:
    """Return the name or the path of the scenario that a file builds upon."""
    base = data[_EXTENDS]
    if not isinstance(base, str):
        raise UsageError(f"{source}: {_EXTENDS} must be the name or the path of a scenario")
    return str(Path(source).parent / base) if not is_named(base) and Path(source).is_file() else base


def lineage(source: str) -> list[str]:
    """Return a scenario and those that it builds upon, the nearest first.

    Args:
        source: its name, or the path of its file; one that `scenario_data` reads.
    """
    found, at_place = [source], _AT_PLACE.fullmatch(source)
    if at_place is not None and source not in SCENARIOS and not Path(source).is_file():
        return [source, *lineage(at_place[1])]
    data = _own_data(source, ())
    return [*found, *lineage(_base_of(data, source))] if isinstance(data, Mapping) and _EXTENDS in data else found


def _merged(base: Any, own: Any) -> Any:
    """Return a mapping with the keys of two, section by section, without those of null; anything else is its own."""
    if not isinstance(own, Mapping):
        return own
    base = base if isinstance(base, Mapping) else {}
    both = {**base, **{key: _merged(base.get(key), value) for key, value in own.items()}}
    return {key: value for key, value in both.items() if value is not None}


def _own_data(source: str, before: tuple[str, ...]) -> Any:
    """Return what stands in a scenario's own file."""
    if source in SCENARIOS.own:
        return parse_yaml((_FOLDER / f"{source}.yaml").read_text(encoding="utf-8"), source)
    at_place = _AT_PLACE.fullmatch(source)
    if is_named(source) and not Path(source).is_file():
        if source not in SCENARIOS and at_place is not None:
            return _at_place(_extended(at_place[1], (*before, source)), source, at_place[1], int(at_place[2]))
        found = SCENARIOS.find(source)
        if isinstance(found, Mapping):
            return found
        return _read(Path(str(found)), f"scenario {source} ({SCENARIOS.target(source)})")
    return _read(Path(source), f"scenario {source}")


def _at_place(data: Any, source: str, name: str, place: int) -> Any:
    """Return a scenario's content with one of its impact places alone."""
    content: Mapping[str, Any] = data if isinstance(data, Mapping) else {}
    protocol: Mapping[str, Any] = content.get("protocol", {})
    places = protocol.get("impact_places", []) if isinstance(protocol, Mapping) else []
    if place not in places:
        known = ", ".join(f"{one:g}" for one in places)
        what = f"its impact places are {known} %" if places else "it has no impact places"
        raise UsageError(f"scenario {source}: {name} cannot be had with an impact place of {place} %: {what}")
    return {**content, "name": source, "protocol": {**protocol, "impact_places": [place]}}


def _read(path: Path, what: str) -> Any:
    """Return the content of a scenario's file."""
    if is_there(path):
        return read_yaml(path)
    near = did_you_mean(str(path), SCENARIOS.names())
    raise UsageError(f"{what}: neither a file nor a known name{near or '; skd scenarios lists all'}")
