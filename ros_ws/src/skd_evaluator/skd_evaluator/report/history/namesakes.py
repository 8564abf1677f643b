"""Encounters that have a name in common and are not the same: nothing else in a list tells them apart."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from skd_sim.encounter.scenario import scenario_from_dict
from skd_sim.errors import UsageError

from skd_evaluator.campaign.compare.encounter_difference import encounter_difference, has_tyres
from skd_evaluator.report.history.runs import Run


def namesakes(runs: Sequence[Run]) -> list[str]:
    """Return a line for each encounter that has the name of an earlier one and differs from it."""
    kinds: dict[str, Run] = {}
    for run in runs:
        kinds.setdefault(json.dumps(run.figures["scenario"], sort_keys=True), run)
    known: dict[str, list[tuple[Run, dict[str, Any]]]] = {}
    found = []
    for run in kinds.values():
        try:
            scenario = scenario_from_dict(run.figures["scenario"], str(run.folder)).as_dict()
        except UsageError:
            continue  # a list shows what was written; whoever reads the result refuses it
        earlier = known.setdefault(run.encounter, [])
        # A car without tyres is in the encounter of any friction: it makes no two of them one.
        alike = [one for one in earlier if has_tyres(one[1]) == has_tyres(scenario)]
        differ = [
            (other, difference)
            for other, its in alike or earlier
            if (difference := encounter_difference(its, scenario)) is not None
        ]
        is_new = len(differ) == len(alike or earlier)
        if is_new and differ:
            other, (key, there, here) = differ[0]
            said = f"{key} is {there} in {other.folder} and {here} in {run.folder}"
            found.append(f"{run.encounter} is the name of different encounters: {said}")
        if is_new or not alike:
            earlier.append((run, scenario))
    return found
