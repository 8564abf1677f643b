"""What a reader should know before believing an assessment, a line each, from the content of its assessment.json.

The same lines stand on the terminal, in the page, in Markdown and in a campaign's table.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from skd_sim.options.car_and_adversary import SKD_OBJECTIVES, first_of
from skd_sim.world.episode import counted_reasons

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.episode_figures import ROAD_EDGE, collision_partner
from skd_evaluator.metrics.aborted import NOT_CREDIBLE, not_credible, too_many_aborted
from skd_evaluator.metrics.margins import longer_search, stopped_at
from skd_evaluator.report.formats import counted

Result = Mapping[str, Any]
"""Content of assessment.json."""
_FEWEST = 10
"""Trials below which a quantile of impacts says little."""
_JUST_ABOVE = 0.25
"""m/s above the hit speed within which nearly all hits are a matter of where it is set."""


def figure_warnings(result: Result) -> list[str]:
    """Return what is to be known of the figures, from the content of assessment.json."""
    found = [nothing] if (nothing := undefined(result)) and result["margin"] is not None else []
    rows = result["per_safe_trajectory"]
    if unsafe := [row for row in rows if not row["safe"]]:
        worst = max(unsafe, key=lambda row: float(row["contact_rate"]))
        count = f"{len(unsafe)} of {counted(len(rows), 'safe trajectory')}"
        collide = f"{100 * worst['contact_rate']:.0f} % of the runs along it collide"
        found.append(f"not safe with this car: {count}, e.g. {worst['name']}: {collide}")
    found += _of_margin(result)
    if (stopped := result["until_width"]) and not stopped["reached"]:
        found.append(stopped["text"])
    if (clipped := result["commands_clipped"])["commands"]:
        count = f"{clipped['commands']} commands in {clipped['episodes']} episodes"
        found.append(f"{count} were beyond what this car can do; they were clipped")
    return [*found, *contact_warnings(result)]


def contact_warnings(result: Result) -> list[str]:
    """Return that a simulator's contacts are others than SKD's; nothing where they are the same."""
    found = result.get("simulator_contacts")
    if not found or not found["geometry_alone"] + found["simulator_alone"]:
        return []
    alone = f"{found['geometry_alone']}, by the simulator's shapes alone in {found['simulator_alone']}"
    which = f"of {found['episodes']} episodes the car touched a road user by SKD's geometry alone in"
    return [f"{which} {alone}; SKD's counts"]


def _of_margin(result: Result) -> Iterator[str]:
    """Yield what is to be known of the margin; nothing where it is not known, or not credible."""
    if result["margin"] is None or not_credible(result.get("warnings") or ()):
        return
    trials, beyond = result["margin_trials"], result["margin_beyond"]
    if not result["margin_converged"]:
        yield f"the search for the margin {stopped_at(result)}: the margin may be less; {longer_search(result)}"
    impact, least = result["impact_speed"], result["scenario"]["collision"].get("hit_speed", 0.0)
    if impact and least > 0.0 and impact["p90"] <= least + _JUST_ABOVE and trials - beyond >= _FEWEST:
        speeds = f"at {impact['p90']:.2f} m/s or less, and a hit begins at {least:g} m/s"
        yield f"90 % of the margin's hits are {speeds}: another collision.hit_speed would give another margin"
    touched, hit = _contacts(result)
    if hit and beyond == trials:
        others = f"{counted(hit, 'other episode')} ended in a hit"
        yield f"the {trials} trials of the margin have no hit within η_max, but {others}: give a greater eta_max"
    elif result["margin_ci95"] is not None and result["margin_ci95"][1] - result["margin_ci95"][0] < _NO_WIDTH:
        same = f"all {trials} trials have the same margin, so its interval has no width: give a greater --safe-count"
        yield same if result["margin_ci95"][1] > _NO_WIDTH else f"in all {trials} trials the car hits on φ itself"
    if touched and not hit and beyond == trials:
        yield f"the car was only walked into: {touched} kamikazes touched it, while it drove slower than {least:g} m/s"


_NO_WIDTH = 1e-9  # m


def _contacts(result: Result) -> tuple[int, int]:
    """Return how many kamikazes touched the car, and how many of them and of runs along φ the moving car hit."""
    touched, hit = 0, round((result["nominal_collision_rate"] or 0.0) * result["collision_runs"])
    for one in result["objectives"].values():
        reached, standing = one["trials"] - one["failed"], one["standing_contacts"]
        hits = reached if one["plans_deviation"] else reached - standing  # others plan for any contact
        touched += hits + standing
        hit += hits
    return touched, hit


def undefined(result: Result) -> str | None:
    """Return why SKD is not defined, in one line; None if it is."""
    if result["skd"] is not None:
        return None
    one = result["objectives"][first_of(SKD_OBJECTIVES, result["objectives"])]
    discarded, reasons = result["discarded_by_distance"], result["aborted_reasons"]
    why = f"all {discarded} are further than the maximum distance" if discarded else "no kamikaze trajectory was found"
    if one["aborted"] and not one["trials"]:
        why = f"every kamikaze episode was aborted ({next(iter(reasons.values()))['first'] or next(iter(reasons))})"
    elif one["aborted"] and not discarded:
        why += f", and {one['aborted']} of {one['trials'] + one['aborted']} kamikaze episodes were aborted"
    return f"{why}; SKD is not defined"


def most_frequent(reasons: Iterable[str]) -> str:
    """Return the first reason of the most frequent kind."""
    kind, most = next(iter(counted_reasons(reasons).items()))
    return str(most["first"] or kind)


def why_failed(assessment: Assessment, maximum_aborted: float, result: Result | None = None) -> list[str]:
    """Return why an assessment counts as failed; that SKD is not defined is no reason where the margin is known.

    Args:
        assessment: the assessment of all episodes, aborted ones counted.
        maximum_aborted: share of the episodes that may be aborted, of all and of those of each figure.
        result: content of its assessment.json, where the assessment is of its episodes alone, which are not all.
    """
    result = result or assessment.as_dict()
    lost = too_many_aborted(result, maximum_aborted)
    why = lost or (undefined(result) if result["margin"] is None else None)
    return [*([why] if why else []), *not_credible(assessment.warnings)]


def with_failures(assessment: Assessment, maximum_aborted: float) -> Assessment:
    """Return the assessment with why it counts as failed among its warnings, where no exit code says it.

    That SKD is not defined makes no margin less credible.
    """
    result = assessment.as_dict()
    too_many = too_many_aborted(result, maximum_aborted)
    found = [undefined(result), f"{NOT_CREDIBLE}{too_many}" if too_many else None]
    return replace(assessment, warnings=(*assessment.warnings, *(line for line in found if line)))


def warnings_of(assessment: Assessment, *, said: Collection[str] = (), result: Result | None = None) -> list[str]:
    """Return what a reader should know that is no failure.

    Args:
        assessment: the assessment with its figures.
        said: lines that were printed already.
        result: content of its assessment.json, where it is known.
    """
    own = [line for line in assessment.warnings if line not in {*not_credible(assessment.warnings), *said}]
    return [*own, *figure_warnings(result or assessment.as_dict()), *_hits_of_others(assessment)]


def _hits_of_others(assessment: Assessment) -> list[str]:
    """Return how often the car ran into others than the adversary, which counts as any collision."""
    others = assessment.plan.scenario.others
    logs = [*assessment.kamikaze_logs, *assessment.nominal_runs] if others or assessment.plan.steers else []
    who = [collision_partner(log) for log in logs]
    left = who.count(ROAD_EDGE)
    off = [f"in {left} of {len(logs)} episodes the car left the road, which counts as a collision"] if left else []
    return off + [
        f"in {who.count(index)} of {len(logs)} episodes the car ran into others[{index}], a {other.kind}, and not into "
        "the adversary; that counts as any collision"
        for index, other in enumerate(others)
        if index in who
    ]
