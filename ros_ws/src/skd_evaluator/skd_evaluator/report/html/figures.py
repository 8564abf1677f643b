"""The figures of the page: what assessment.json holds, in words and in rows; nothing is computed anew."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from skd_sim.car_under_test import CarUnderTest
from skd_sim.episode import Mode

from skd_evaluator.report.html.formats import (
    NOTHING,
    counted,
    interval,
    number,
    percent,
    percent_interval,
)
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.repeat import CONTROLLER_COMMAND, scenario_name

_FEW = 3
"""Most pairs of cars that a sentence names."""
_SAME_MULTIPLIER = 1e-9


@dataclass(frozen=True)
class Row:
    """A figure with its intervals.

    Attributes:
        name: of the figure.
        value: of it.
        clustered: its 95 % interval by φ.
        plain: its 95 % interval with attempts, pairs or runs taken as independent of one another.
        basis: of how many it is.
        main: it is one of those that are read first.
    """

    name: str
    value: str
    clustered: str = NOTHING
    plain: str = NOTHING
    basis: str = ""
    main: bool = False


def figure_rows(subject: Subject) -> list[Row]:
    """Return the figures of a car, those that are read first first."""
    figures, ranking = subject.figures, subject.ranking
    phis = counted(len(figures["per_safe_trajectory"]), "φ")
    rows = [
        Row(
            "deformation (m)",
            number(figures["deformation"]),
            interval(figures.get("deformation_ci95")),
            interval(figures["deformation_ci95_attempts"]),
            f"{counted(ranking['attempts'], 'attempt')} over {phis}; {ranking['failed']} failed, which count as "
            f"{figures['eta_max']:g} m",
            main=True,
        ),
        Row(
            "equivalent multiplier C",
            figures["equivalent_multiplier_text"] or NOTHING,
            _equivalent_interval(figures, "ci95"),
            _equivalent_interval(figures, "ci95_these_phi"),
            figures["equivalent_multiplier_note"] or "the basic car with the same deformation on the same φ",
            main=True,
        ),
        Row(
            "collision rate along φ",
            percent(figures["collision_rate"]),
            percent_interval(figures.get("collision_rate_ci95")),
            percent_interval(figures["collision_rate_ci95_runs"]),
            f"{counted(figures['collision_runs'], 'run')} over {phis}, in which nobody planned",
            main=True,
        ),
        Row(
            "SKD (m)",
            number(figures["skd"]),
            interval(figures.get("skd_ci95")),
            interval(figures["skd_ci95_pairs"]),
            f"{counted(figures['pairs'], 'pair')} over {phis}; the paper's interval is that over pairs",
            main=True,
        ),
        Row(
            "prefix distance (m)",
            number(figures["skd_prefix"]),
            interval(figures.get("skd_prefix_ci95")),
            interval(figures["skd_prefix_ci95_pairs"]),
            "as SKD, φ cut at the duration of ψ",
        ),
    ]
    for name, found in figures["objectives"].items():
        tried = f"{found['attempts'] - found['failed']} of {counted(found['attempts'], 'attempt')}"
        walked = f"; {found['standing_contacts']} walked into a standing car" if found["standing_contacts"] else ""
        rows.append(
            Row(
                f"success rate, kamikazes of objective {name}",
                percent(found["success_rate"]),
                percent_interval(found.get("success_rate_ci95")),
                percent_interval(found.get("success_rate_ci95_attempts")),
                f"{tried}{walked}",
            )
        )
    rows += _floors(figures)
    rows.append(Row("mean impact speed (m/s)", number(figures["mean_impact_speed"], 2), basis="of the pairs of SKD"))
    for one in figures["measures"].values():
        if one["shown"] and not one["error"]:
            name = f"{one['label']} ({one['unit']})" if one["unit"] else one["label"]
            undefined = f"{one['undefined']} pairs without" if one["undefined"] else ""
            rows.append(Row(name, number(one["mean"]), interval(one["ci95"]), interval(one["ci95_pairs"]), undefined))
    for eta, bound in figures["probability_bound"].items():
        rows.append(
            Row(
                f"P(distance ≤ {eta} m), bound of Theorem 1",
                number(bound),
                basis="of these kamikazes, not of better ones",
            )
        )
    return rows


def _equivalent_interval(figures: Mapping[str, Any], which: str) -> str:
    """Return an interval of the equivalent multiplier, `ci95` or `ci95_these_phi`; its ends may be open."""
    name = f"equivalent_multiplier_{which}"
    ends, text = figures[name] or (None, None), figures[f"{name}_text"]
    own = figures["multiplier"]
    # A basic car is compared with itself, in the same attempts: there is no chance in that.
    if own is not None and all(end is not None and abs(end - own) < _SAME_MULTIPLIER for end in ends):
        return "exact by construction"
    return (text or NOTHING).strip("[]").replace(", ", " to ")


def _floors(figures: Mapping[str, Any]) -> list[Row]:
    found = []
    for prefix, what in (("deformation_", "deformation"), ("", "SKD")):
        if figures[f"{prefix}floor"] is not None:
            found.append(
                Row(
                    f"clairvoyant floor of {what} (m)",
                    number(figures[f"{prefix}floor"]),
                    plain=interval(figures[f"{prefix}floor_ci95"]),
                    basis=f"{what} / floor: {number(figures[f'{prefix}closeness'], 2)}",
                )
            )
    return found


def state_of(subject: Subject) -> str:
    """Return whether a rating can be believed: `failed` (there is none), `doubtful` (read the warnings) or `fine`."""
    figures = subject.figures
    if figures["deformation"] is None or figures["skd"] is None:
        return "failed"
    return "doubtful" if warnings_of(subject) else "fine"


def sentence_of(subject: Subject) -> str:
    """Return in one sentence what was found about a car."""
    figures, ranking = subject.figures, subject.ranking
    if figures["deformation"] is None:
        aborted = figures["aborted"]
        why = f"{counted(aborted, 'episode')} were aborted" if aborted else "no attempt ran"
        return f"This is no rating: no kamikaze ran to its end ({why}). It says nothing about the car."
    if ranking["attempts"] == ranking["failed"]:
        return (
            f"None of {counted(ranking['attempts'], 'attempt')} made this car hit the pedestrian; each counts as "
            f"{figures['eta_max']:g} m, the most that is counted."
        )
    hit = percent(ranking["success_rate"], 0)
    along = figures["collision_rate"]
    failed = f", and one that failed counts as {figures['eta_max']:g} m" if ranking["failed"] else ""
    rest = "" if along is None else f" Of those who simply follow φ, {percent(along)} are hit."
    return (
        f"To be hit, a pedestrian had to be {number(figures['deformation'], 2, 'm')} from where the safe crossing "
        f"would have had him, at the worst moment and on average; {hit} of the attempts succeeded{failed}.{rest}"
    )


def warnings_of(subject: Subject) -> list[str]:
    """Return what a reader should know before believing the figures, a line each."""
    figures = subject.figures
    found = []
    for kind, reasons in figures["aborted_reasons"].items():
        first = f", the first one so: {reasons['first']}" if reasons.get("first") else ""
        found.append(f"{counted(reasons['count'], 'episode')} aborted ({kind}){first}; they count in no figure")
    for row in figures["per_safe_trajectory"]:
        if not row["safe"]:
            found.append(
                f"safe trajectory {row['name']} was hit in {percent(row['collision_rate'], 0)} of "
                f"{counted(row['collision_runs'], 'run')} along it: with this car it is not safe, and a kamikaze need "
                "not leave it"
            )
    clipped = figures["commands_clipped"]
    if clipped["commands"]:
        found.append(
            f"{counted(clipped['commands'], 'command')} in {counted(clipped['episodes'], 'episode')} asked more than "
            "this car can do; they were clipped"
        )
    for one in figures["measures"].values():
        if one["error"]:
            found.append(f"measure {one['label']} failed: {one['error']}")
    if figures["discarded_by_distance"]:
        found.append(f"{counted(figures['discarded_by_distance'], 'pair')} discarded, above the maximum distance")
    found += [f"left out: {line}" for line in figures["left_out"]]
    found += [str(line) for line in figures["warnings"]]
    if figures["deformation"] is not None and figures["skd"] is None:
        found.append("no pair is left, so SKD is not defined")
    return found


def ranking_notes(subjects: Sequence[Subject]) -> list[str]:
    """Return who is safer than whom by deformation, for each set of φ; where φ differ metres do not compare."""
    groups: dict[bytes, list[Subject]] = {}
    for one in subjects:
        if one.figures["deformation"] is not None:
            groups.setdefault(one.safe_key, []).append(one)
    found = []
    for members in groups.values():
        if len(members) < 2:
            continue
        ordered = sorted(members, key=lambda one: float(one.figures["deformation"]))
        last, first = ordered[-1], ordered[0]
        close = [
            f"{low.label} and {high.label}"
            for low, high in itertools.pairwise(ordered)
            if _overlap(low.figures.get("deformation_ci95"), high.figures.get("deformation_ci95"))
        ]
        text = (
            f"Of {counted(len(members), 'assessment')} over the same φ, {last.label} is the safest by deformation "
            f"({number(last.figures['deformation'], 2, 'm')}) and {first.label} the most vulnerable "
            f"({number(first.figures['deformation'], 2, 'm')})."
        )
        if close and len(members) == 2:
            state = "overlap" if _known(members) else "are not known"
            text += f" Their intervals by φ {state}; skd compare judges such pairs."
        elif close:
            which = f": {'; '.join(close)}" if len(close) <= _FEW else ""
            text += (
                f" Of {len(members) - 1} pairs of neighbours, {len(close)} have intervals by φ that overlap"
                f"{'' if _known(members) else ', or none'}{which}; "
                "skd compare judges such pairs."
            )
        found.append(text)
    if len(groups) > 1:
        found.append("The assessments are over different φ: metres compare only within the same φ.")
    return found


def unranked_notes(subjects: Sequence[Subject]) -> list[str]:
    """Return why cars have no equivalent multiplier, once for all that have it in common."""
    groups: dict[str, list[str]] = {}
    for one in subjects:
        if not one.figures["equivalent_multiplier_text"] and one.figures["equivalent_multiplier_note"]:
            groups.setdefault(str(one.figures["equivalent_multiplier_note"]), []).append(one.label)
    return [
        f"{', '.join(labels) if len(labels) <= _FEW else counted(len(labels), 'car')}: {note}"
        for note, labels in groups.items()
    ]


def _known(subjects: Sequence[Subject]) -> bool:
    return all(one.figures.get("deformation_ci95") for one in subjects)


def _overlap(one: Sequence[float] | None, other: Sequence[float] | None) -> bool:
    return one is None or other is None or (one[0] <= other[1] and other[0] <= one[1])


def per_safe_rows(subject: Subject) -> list[dict[str, str | bool]]:
    """Return a row for each φ."""
    rows = zip(subject.figures["per_safe_trajectory"], subject.ranking["per_safe_trajectory"], strict=True)
    return [
        {
            "name": str(row["name"]),
            "safe": bool(row["safe"]),
            "collision_rate": percent(row["collision_rate"]),
            "collision_runs": str(row["collision_runs"]),
            "deformation": number(row["deformation"]),
            "attempts": f"{mine['failed']} of {mine['attempts'] - mine['aborted']}",
            "aborted": str(mine["aborted"]),
            "skd": number(row["skd"]),
            "skd_prefix": number(row["skd_prefix"]),
            "pairs": str(row["pairs"]),
        }
        for row, mine in rows
    ]


def same_safe(subject: Subject) -> list[str]:
    """Return the names of φ that are one and the same: assessment.json counts the runs along them together."""
    names = [str(row["name"]) for row in subject.figures["per_safe_trajectory"]]
    groups: dict[bytes, list[str]] = {}
    for name, phi in zip(names, subject.episodes.safe, strict=True):
        groups.setdefault(phi.tobytes(), []).append(name)
    return [" and ".join(group) for group in groups.values() if len(group) > 1]


def timing_row(subject: Subject) -> dict[str, str]:
    """Return what is known of the time that an assessment took."""
    episodes = subject.episodes
    kamikaze = episodes.mode == Mode.KAMIKAZE
    decisions = sum(len(way) - 1 for way, mine in zip(episodes.pedestrian, kamikaze, strict=True) if mine)
    seconds, count = float(subject.figures["seconds"]), len(episodes) + int(subject.figures["aborted"])
    return {
        "kamikazes": f"{int(kamikaze.sum()):,}",
        "decisions": f"{decisions:,}",
        "simulations": f"{subject.figures['simulations']:,}",
        "runs": f"{len(episodes) - int(kamikaze.sum()):,}",
        "seconds": number(seconds, 1),
        "each": number(1000.0 * seconds / count, 2) if count else NOTHING,
    }


def _origin_rows(origin: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Return what `provenance` of a result says; a replayed or older one may lack it."""
    if origin is None:
        return [("not recorded", "date, host, command line, revision and hashes")]
    git = origin["git"]
    rows = [
        ("date", str(origin["date"])),
        ("host", f"{origin['host']} ({origin['platform']}, Python {origin['python']})"),
        ("command line", str(origin["command"])),
        ("git revision", f"{git['revision']}{', modified' if git['modified'] else ''}" if git else NOTHING),
    ]
    rows += [(f"SHA-256 of {one['path']}", str(one["sha256"])) for one in origin["controller_files"]]
    if origin["car_model_sha256"]:
        rows.append(("SHA-256 of the car model", str(origin["car_model_sha256"])))
    return rows


def made_rows(subject: Subject) -> list[tuple[str, str]]:
    """Return how an assessment was made, as names and values."""
    figures = subject.figures
    car = CarUnderTest(str(figures["controller"]))
    rows = [
        ("folder", str(subject.folder)),
        ("version of SKD", str(figures["version"])),
        ("controller", car.controller),
        ("multiplier C", NOTHING if figures["multiplier"] is None else f"{figures['multiplier']:g}"),
        ("safe trajectories", f"{figures['safe']} ({len(figures['per_safe_trajectory'])})"),
        ("scenario", scenario_name(figures) or f"{figures['scenario']['name']} (of its own: see the file below)"),
        ("seed", str(figures["seed"])),
        ("planner's budget", f"{figures['simulations']:,} simulations per decision"),
        ("objectives", ", ".join(figures["objectives"])),
        ("maximum distance", number(figures["maximum_distance"], 2, "m")),
        ("further options", ", ".join(f"{key} = {value}" for key, value in figures["options"].items()) or NOTHING),
        ("model of the car", "fitted: see the file below" if figures["car_model"] else "none, or the known C"),
    ]
    rows += _origin_rows(figures.get("provenance"))
    if car.is_external:
        rows.append((CONTROLLER_COMMAND, "in a command: what starts the controller's node; the folder has no record"))
    return rows
