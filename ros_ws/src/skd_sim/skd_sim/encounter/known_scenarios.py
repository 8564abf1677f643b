"""Scenarios that have a name: those that come with SKD, and those of installed packages."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from skd_sim.choices.registry import Registry
from skd_sim.choices.suggestion import did_you_mean
from skd_sim.errors import UsageError
from skd_sim.inputs.yaml_file import parse_yaml, read_text

_FOLDER = resources.files("skd_sim") / "scenarios"


def shipped_scenarios() -> list[str]:
    """Return the names of the scenarios that come with SKD."""
    return sorted(entry.name.removesuffix(".yaml") for entry in _FOLDER.iterdir() if entry.name.endswith(".yaml"))


SCENARIOS = Registry("scenario", "skd.scenarios", {name: f"skd_sim.scenarios:{name}" for name in shipped_scenarios()})
"""SKD's own are files of a folder. An entry point leads to a path of a YAML file, or to a mapping with its keys."""


def scenario_data(source: str) -> Any:
    """Return the content of a scenario: a shipped one, one of an installed package, or a YAML file.

    Args:
        source: name of the scenario, or path of its file.

    Raises:
        UsageError: there is no such scenario, or it is no YAML.
    """
    if source in SCENARIOS.own:
        return parse_yaml((_FOLDER / f"{source}.yaml").read_text(encoding="utf-8"), source)
    if source in SCENARIOS and not Path(source).is_file():
        found = SCENARIOS.find(source)
        if isinstance(found, Mapping):
            return found
        return parse_yaml(_read(Path(str(found)), f"scenario {source} ({SCENARIOS.target(source)})"), source)
    return parse_yaml(_read(Path(source), f"scenario {source}"), source)


def _read(path: Path, what: str) -> str:
    try:
        return read_text(path)
    except (OSError, ValueError) as error:
        if isinstance(error, UsageError):
            raise
        known = SCENARIOS.names()
        near = did_you_mean(str(path), known)
        raise UsageError(f"{what}: not a readable file, nor one of: {', '.join(known)}{near}") from error
