"""Who plans a problem of the planning benchmark, and with which options: the problem's own, or as the command says."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from enum import IntEnum
from types import NoneType, UnionType
from typing import Any, Final, get_args, get_type_hints

from default_policy import DefaultPolicy
from planning_problems import PROBLEMS, converted
from skd_adversary.planning.general.pft_dpw import PftDpw, PftDpwOptions
from skd_adversary.planning.general.pomcpow import Pomcpow, PomcpowOptions
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.planner import Planner

PLANNERS: Final[dict[str, tuple[type, type[PlannerOptions]]]] = {
    "ours": (Planner, PlannerOptions),
    "pomcpow": (Pomcpow, PomcpowOptions),
    "pft_dpw": (PftDpw, PftDpwOptions),
    "default_policy": (DefaultPolicy, PlannerOptions),
}


def options_of(name: str, planner: str, settings: Mapping[str, Any] | None = None) -> PlannerOptions:
    """Return a planner's options for a problem: its own there, or ours as far as they mean something to it.

    Args:
        name: of the problem.
        planner: one of `PLANNERS`.
        settings: option → value instead of the problem's.

    Raises:
        ValueError: no planner can have these options.
    """
    problem, kind = PROBLEMS[name], PLANNERS[planner][1]
    options = problem.others.get(planner) or converted(problem.options, kind)
    return replace(options, **(settings or {}))


def settings_of(planner: str, texts: Iterable[str]) -> dict[str, Any]:
    """Return option → value of texts NAME=VALUE; the last one counts.

    Raises:
        ValueError: the planner has no such option, or the value is none of its kind; one line.
    """
    kinds = get_type_hints(PLANNERS[planner][1])
    del kinds["simulations"]  # has an argument of its own, beside the time that may take its place
    settings = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if name == "simulations":
            raise ValueError(f"{text}: simulations a move are not set, but given as --simulations N")
        if name not in kinds:
            raise ValueError(f"{planner} has no option {name!r} to set; it has {', '.join(sorted(kinds))}")
        if not equals:
            raise ValueError(f"{text}: expected {name}=VALUE")
        settings[name] = _value(kinds[name], name, value)
    return settings


def _value(kind: Any, name: str, text: str) -> Any:
    if isinstance(kind, UnionType):  # a number, or None
        if text == "none":
            return None
        (kind,) = set(get_args(kind)) - {NoneType}
    if issubclass(kind, IntEnum):
        values: dict[str, Any] = dict(kind.__members__)
    elif kind is bool:
        values = {"true": True, "false": False}
    else:
        return _number(kind, name, text)
    if text not in values:
        raise ValueError(f"{name}={text}: expected {' or '.join(values)}")
    return values[text]


def _number(kind: type, name: str, text: str) -> Any:
    try:
        value = kind(text)
    except ValueError:
        value = math.nan
    if not value >= 0:
        raise ValueError(f"{name}={text}: expected {'a whole number' if kind is int else 'a number'}, not negative")
    return value
