"""The table of figures: what stands in assessment.json, a row each, in the order in which it is written.

A new figure is one row: its key, unit and schema, a function of what it is of, its intervals, which way is better, and
where it is shown. Whatever writes, shows, checks or compares figures goes through this table.
"""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Any

from skd_sim.options.options import further_options
from skd_sim.world.episode import counted_reasons

from skd_evaluator.assessment.episode_figures import closing_speed, command_age, simulator_contacts, standing_contacts
from skd_evaluator.metrics.entry import Schema, or_null, ref
from skd_evaluator.metrics.margins import equivalent_entries
from skd_evaluator.version import version

Value = Callable[[Any], Any]
CI95, THESE_PHI = "ci95", "ci95_these_phi"


class Of(Enum):
    """What a figure is computed of, which says where it stands.

    At the top stand those of the margin (`Margins`), of the risk (`Risks`), of caution
    (`PriceOfCaution`), of the car and settings, which no gate
    may ask for (both of `Assessment`). Those of the deviation, by which planned kamikazes rank cars, and of SKD stand
    under each objective (of `ObjectiveResult`), and at the top those of the kamikazes that rank the car, or that SKD is
    of; those of an objective stand there alone. In the rows of each φ stand those of φ; of PHI_TOP at the top alone.
    """

    MARGIN, CAR, SETTING, RANKING, SKD, OBJECTIVE, PHI, PHI_TOP, RISK, PRICE = range(10)


class Better(StrEnum):
    """Which way is better for the car."""

    MORE, LESS, NEAR_1, NEITHER = "more", "less", "near 1", ""


@dataclass(frozen=True)
class Kind:
    """What a figure is written as, and how it is shown.

    Attributes:
        schema: of its JSON.
        unit: of its values; of a percentage the JSON has the share.
        digits: that are shown after the point.
    """

    schema: Schema
    unit: str = ""
    digits: int = 3

    @property
    def scale(self) -> float:
        """By what a value is multiplied to be shown."""
        return 100.0 if self.unit == "%" else 1.0


def _typed(*names: str, **rest: Any) -> Kind:
    return Kind({"type": names[0] if len(names) == 1 else list(names), **rest})


def _each(schema: Schema) -> Kind:
    return Kind({"type": "object", "additionalProperties": schema})


LENGTH, NUMBER = Kind(ref("number_or_null"), "m"), Kind(ref("number_or_null"))
SPEED, RATIO = Kind(ref("number_or_null"), "m/s", 2), Kind(ref("number_or_null"), digits=2)
TIME = Kind(ref("number_or_null"), "s", 2)
SHARE = Kind(ref("rate"), "%", 1)
PROBABILITY = Kind(ref("rate"), digits=2)  # significant ones: it may be very small
SPEEDS = Kind(or_null(ref("speeds")), "m/s", 1)  # their mean and 90 % quantile
COUNT = Kind({"type": "integer", "minimum": 0}, digits=0)
COUNT_OR_NULL = Kind({"type": ["integer", "null"], "minimum": 0}, digits=0)
FLAG, FLAG_OR_NULL = _typed("boolean"), _typed("boolean", "null")
TEXT, TEXT_OR_NULL, LINES = _typed("string"), _typed("string", "null"), _typed("array", items={"type": "string"})
INTERVAL, OPEN_INTERVAL = Kind(ref("interval")), Kind(ref("open_interval"))


@dataclass(frozen=True)
class Figure:
    """A row of the table.

    Attributes:
        key: in assessment.json.
        kind: what it is written as, and how it is shown.
        value: computes it of its subject (`Of`); None in the rows of each φ, which are computed together.
        says: what it is, for the schema.
        of: whose it is.
        label: what it is called where people read it.
        better: which way is better for the car.
        by_phi: computes its interval by φ, `…_ci95`; None: it has none.
        independent: the end of the key of its interval that takes trials, pairs or runs as independent; empty: none.
        plain: computes that interval.
        bare: it stands without its intervals where several cars do.
        source: its key under an objective, where that is another one; then it stands there as a row of its own.
        per_phi: it stands in the rows of each φ, too.
        spoken: the texts beside it are what is shown, for it may lie beyond what was compared.
        clustered: `clustering` has what its interval by φ is made of.
        planned: what kamikazes know of the car stands beside it.
        recomputed: whether it follows from the episodes beside it.
        optional: it is there only where it is known.
        first: it is one of the few of `summary` that the terminal and the page show first.
        summary: its place among the rows of the gate's Markdown, as others below; 0: it is not there.
        details: in the terminal's `--details` and the page's table, behind those that are written out there.
        chart: among the charts of several cars in the report.
        difference: among the differences of `skd compare`, for which `StoredResult.groups` has to have it.
        campaign: among the columns of campaign.json and campaign.csv.
        sweep: among those of sweep.json and sweep.csv.
        compare: in the rows of comparison.json.
        junit: among the properties in JUnit's XML.
    """

    key: str
    kind: Kind
    value: Value | None
    says: str = ""
    of: Of = Of.CAR
    label: str = ""
    better: Better = Better.NEITHER
    by_phi: Value | None = None
    independent: str = ""
    plain: Value | None = None
    bare: bool = False
    source: str = ""
    per_phi: bool = False
    spoken: bool = False
    clustered: bool = False
    planned: bool = False
    recomputed: bool = True
    optional: bool = False
    first: bool = False
    summary: int = 0
    details: int = 0
    chart: int = 0
    difference: int = 0
    campaign: int = 0
    sweep: int = 0
    compare: int = 0
    junit: int = 0

    @property
    def ends(self) -> tuple[str, ...]:
        """What follows its key in the keys of its intervals, in the order in which they are written."""
        return tuple(f"_{end}" for end in (self.independent, CI95 if self.by_phi else "") if end)

    @property
    def keys(self) -> tuple[str, ...]:
        """Its key and those of its intervals."""
        return (self.key, *(f"{self.key}{end}" for end in self.ends))

    @property
    def title(self) -> str:
        """Its label with its unit, which a percentage brings with its values."""
        return f"{self.label} ({self.kind.unit})" if self.kind.unit not in ("", "%") else self.label

    @property
    def heading(self) -> str:
        """Its label with its unit, above values that have none."""
        return f"{self.label} ({self.kind.unit})" if self.kind.unit else self.label

    def entries(self, subject: Any) -> Iterator[tuple[str, Any]]:
        """Yield the keys that it is written under, and what stands there of a subject; null without one."""
        ends = (self.value, *filter(None, (self.plain, self.by_phi)))
        for key, value in zip(self.keys, ends, strict=True):
            yield key, None if subject is None or value is None else value(subject)

    def schemas(self) -> Iterator[tuple[str, Schema]]:
        """Yield the keys that it is written under, and their schemas."""
        yield self.key, self.described()
        unit = ", m" if self.kind is LENGTH else ""
        independent = _OF_INDEPENDENT_EPISODES if self.kind is SHARE else f"{_OF_INDEPENDENT}{unit}"
        if self.kind is PROBABILITY:
            independent = _OF_THESE_PHI
        for end in self.ends:
            by_phi = self.by_phi and end == f"_{CI95}"
            said = f"95 % interval of it over φ{unit}" if by_phi else independent
            yield f"{self.key}{end}", {**INTERVAL.schema, "description": said}

    def described(self) -> Schema:
        """Return the schema of its value alone."""
        return {**self.kind.schema, "description": self.says} if self.says else self.kind.schema


_OF_INDEPENDENT = "95 % interval of it, trials or pairs taken as independent"
_OF_THESE_PHI = "95 % interval of the estimate, for these φ"
_OF_INDEPENDENT_EPISODES = "95 % interval of it, episodes taken as independent"
_MARGIN, _DEVIATION, _SKD, _OBJECTIVE, _SETTING = Of.MARGIN, Of.RANKING, Of.SKD, Of.OBJECTIVE, Of.SETTING
_RISK, _PRICE = Of.RISK, Of.PRICE
_MORE, _LESS = Better.MORE, Better.LESS
_RATE: dict[str, Any] = {
    "by_phi": lambda o: o.success_rate.interval,
    "independent": "ci95_trials",
    "plain": lambda o: o.success_rate.plain_interval,
}


def _risk(scale: float) -> dict[str, Any]:
    """Return what the rows of the risk have in common."""

    def of(name: str) -> Value:
        return lambda risks: getattr(risks.at(scale), name, None)

    return {
        "of": _RISK, "better": _LESS, "value": of("value"), "by_phi": of("ci95_by_phi"), "independent": "ci95_runs",
        "plain": of("ci95"),
    }  # fmt: skip


def _equivalent(end: str) -> Value:
    return lambda a: equivalent_entries(a.equivalent)[f"equivalent_multiplier{end}"]


FIGURES = (
    Figure("margin", LENGTH, lambda m: m.mean,
           "mean over all trials of the least deviation at which the moving car hits, at most eta_max each, m; null: "
           "not known",
           _MARGIN, "margin", _MORE, by_phi=lambda m: m.ci95, summary=1, first=True, chart=1, difference=1,
           campaign=1, sweep=1, compare=1, junit=1),
    Figure("margin_p10", LENGTH, lambda m: m.quantile(0.1),
           "10 % of the trials have a margin of at most this, m: how little is enough in the worst of them", _MARGIN,
           "margin that 10 % of the trials do not exceed", _MORE, details=2, campaign=25, compare=24),
    Figure("margin_converged", FLAG_OR_NULL, lambda m: m.converged,
           "whether the search has converged; if not, the margin is an upper bound; exact ones are", _MARGIN,
           recomputed=False, campaign=2, compare=2, junit=2),
    Figure("margin_budget", COUNT_OR_NULL, lambda m: m.search and m.search.budget,
           "candidate trajectories that the search drove in a trial; null: it is exact, or not known", _MARGIN,
           recomputed=False, campaign=3, compare=3),
    Figure("margin_excess", Kind(or_null(ref("margin_excess"))),
           lambda m: m.search and m.search.excess and m.search.excess.as_dict(),
           "how much too high it may be, estimated from trials that were searched deeper; null: exact, or not known",
           _MARGIN, recomputed=False),
    Figure("margin_sources", _typed("array", "null", items=ref("margin_source")),
           lambda m: m.search and [dict(one) for one in m.search.sources],
           "what each source of candidates brought; null: it is exact, or not known", _MARGIN, recomputed=False),
    Figure("margin_lanes", _each({"type": "number"}), lambda m: dict(m.lanes),
           "margin with the oncoming lane free and occupied, m; the lower one, which is the margin, stands first; "
           "missing: the car keeps to its lane", _MARGIN, recomputed=False, optional=True),
    Figure("margin_gap", LENGTH, lambda m: m.gap,
           "the least is at most so far below the margin, m; null: it was searched for", _MARGIN),
    Figure("margin_trials", COUNT_OR_NULL, lambda m: int(m.values.size), "trials of which it is the mean", _MARGIN,
           compare=6),
    Figure("margin_beyond", COUNT_OR_NULL, lambda m: m.beyond, "trials without a hit within eta_max",
           _MARGIN, campaign=5, compare=7),
    Figure("margin_how", TEXT_OR_NULL, lambda m: m.search.how if m.search else "",
           "what was driven, where it was not the car itself in process", _MARGIN, recomputed=False, campaign=4,
           compare=4),
    Figure("impact_speed", SPEEDS, lambda m: m.impact_speed,
           "speed of the car when it hits on the margin trajectories, m/s: mean and 90 % quantile", _MARGIN,
           "impact speed", _LESS, summary=3, first=True, campaign=6, compare=13),
    Figure("risk_1", PROBABILITY,
           says="R(1): probability that the moving car's front hits a road user who walks φ with natural variation",
           label="risk R(1)", **_risk(1.0), summary=4, first=True, details=4, difference=7, campaign=26, compare=25,
           junit=12),
    Figure("risk_2", PROBABILITY, says="R(2): the same of people who deviate twice as much", label="risk R(2)",
           **_risk(2.0), summary=13, details=5, difference=8, campaign=27, compare=26),
    Figure("risk_3", PROBABILITY, says="R(3): three times as much", label="risk R(3)", **_risk(3.0), summary=14,
           details=6, difference=9, campaign=28, compare=27),
    Figure("risk", Kind(or_null(ref("risk"))), lambda r: r.as_dict(),
           "by which behaviour model, and how it was estimated", _RISK),
    Figure("risk_note", TEXT, lambda a: a.risk_note, "why the risk is not known", recomputed=False, campaign=29),
    Figure("time_lost", TIME, lambda p: p.time_lost,
           "mean time that the car loses on a road user who is not in its path, s", _PRICE,
           "price of caution", _LESS, independent=CI95,
           plain=lambda p: None if p.time_lost is None else p.ci95("time_lost"),
           recomputed=False, summary=5, first=True, campaign=30, compare=28, junit=13),
    Figure("deadlock", SHARE, lambda p: p.mean("deadlock"),
           "share of these runs in which the car has not got past after 30 s", _PRICE, "does not get past", _LESS,
           independent=CI95, plain=lambda p: p.ci95("deadlock"), recomputed=False, summary=15, details=7, campaign=31,
           compare=29),
    Figure("needless", SHARE, lambda p: p.mean("needless"),
           "share of these runs in which the car brakes by 0.25 g or more for 0.2 s, and not with the road to itself",
           _PRICE, "needless hard braking", _LESS, independent=CI95, plain=lambda p: p.ci95("needless"),
           recomputed=False, summary=16, details=8, campaign=32, compare=30),
    Figure("slow", TIME, lambda p: p.mean("slow"),
           "mean time that the car takes longer than at its start speed with the road to itself, s", _PRICE,
           "slower than at its start speed", _LESS, independent=CI95, plain=lambda p: p.ci95("slow"),
           recomputed=False, details=9, campaign=33, compare=31),
    Figure("harmless_lane_left", SHARE, lambda p: (p.lanes_left or (None,))[0],
           "share of these runs in which a corner of the car is beyond its lane; missing: in none", _PRICE,
           "leaves its lane in harmless runs", recomputed=False, details=12, optional=True),
    Figure("harmless_lane_left_time", TIME, lambda p: (p.lanes_left or (None, None))[1],
           "mean time that a corner is beyond its lane in these, s", _PRICE, "time out of its lane in these",
           recomputed=False, details=13, optional=True),
    Figure("price_of_caution", Kind(or_null(ref("price_of_caution"))), lambda p: p.as_dict(),
           "the runs behind it", _PRICE, recomputed=False),
    Figure("price_note", TEXT, lambda a: a.price_note, "why the price of caution is not known", recomputed=False),
    Figure("margin_note", TEXT, lambda a: a.margin_note, "why the margin is not known",
           recomputed=False, compare=5),
    Figure("optimality_gap", RATIO, lambda a: a.optimality_gap()[0],
           "planned deviation over margin, in the same trials", by_phi=lambda a: a.optimality_gap()[1],
           label="optimality gap, planned / margin", better=Better.NEAR_1, summary=8, first=True, campaign=7,
           sweep=5, compare=17, junit=7),
    Figure("deviation", LENGTH, lambda o: o.deviation.mean,
           "restricted mean deviation of planned kamikazes over all trials, m; one that is not hit counts as eta_max",
           _DEVIATION, "planned deviation", _MORE, by_phi=lambda o: o.deviation.interval,
           independent="ci95_trials", plain=lambda o: o.deviation.plain_interval, per_phi=True,
           clustered=True, planned=True, summary=7, first=True, chart=3, difference=2, campaign=9, sweep=2, compare=15,
           junit=5),
    Figure("deviation_of_successes", LENGTH, lambda o: o.of_successes.mean,
           "mean deviation of the trials that the moving car hit, m", _DEVIATION, independent=CI95,
           plain=lambda o: o.of_successes.plain_interval, better=_MORE, bare=True, per_phi=True, campaign=10,
           sweep=3),
    Figure("deviation_success_rate", SHARE, lambda o: o.success_rate.value,
           "success rate of the kamikazes whose deviation is reported",
           _DEVIATION, better=_LESS, **_RATE, bare=True, source="success_rate",
           clustered=True, campaign=11, sweep=4, compare=16),
    Figure("equivalent_multiplier", NUMBER, _equivalent(""),
           "C of the basic car with the same margin on the same φ; null beyond those compared, or not known. "
           "With C >= 1 that car itself does not get past people",
           label="equivalent multiplier C", better=_MORE, spoken=True, recomputed=False, summary=6, first=True,
           campaign=12, compare=8),
    Figure("equivalent_multiplier_text", TEXT_OR_NULL,
           _equivalent("_text"), "the same in words, as \"above 2\"; null: not known", recomputed=False, compare=9,
           junit=3),
    Figure("equivalent_multiplier_ci95", OPEN_INTERVAL,
           _equivalent("_ci95"), "95 % interval of it over φ",
           recomputed=False, compare=10),
    Figure("equivalent_multiplier_ci95_text", TEXT_OR_NULL,
           _equivalent("_ci95_text"), "the same in words", recomputed=False,
           compare=11),
    Figure("equivalent_multiplier_ci95_these_phi", OPEN_INTERVAL,
           _equivalent("_ci95_these_phi"),
           "95 % interval of it on these φ", recomputed=False, campaign=13),
    Figure("equivalent_multiplier_ci95_these_phi_text", TEXT_OR_NULL,
           _equivalent("_ci95_these_phi_text"), "the same in words",
           recomputed=False),
    Figure("measures", _each(ref("measure")), lambda o: o.measure_figures(),
           "further measures of the pairs, by name", _DEVIATION),
    Figure("equivalent_multiplier_note", TEXT, lambda a: a.equivalent_note,
           "why it is not known, or of fewer trials", recomputed=False),
    Figure("reference", _typed("array", items=ref("reference")), lambda a: [one.as_dict() for one in a.reference],
           "how the car stands beside reference drivers in its first trials; missing: not requested",
           recomputed=False, optional=True),
    Figure("eta_max", Kind({"type": "number", "exclusiveMinimum": 0}, "m"), lambda a: a.plan.scenario.eta_max,
           "η_max, m", _SETTING, campaign=23, compare=21),
    Figure("skd", LENGTH, lambda o: o.skd.distances.mean,
           "Safe-Kamikaze Distance: mean discrete Fréchet distance of all pairs, m", _SKD, "SKD", _MORE,
           by_phi=lambda o: o.skd.distances.interval, independent="ci95_pairs",
           plain=lambda o: o.skd.distances.plain_interval,
           per_phi=True, clustered=True, summary=9, first=True, chart=4, difference=3, campaign=15, sweep=6,
           compare=19, junit=8),
    Figure("skd_prefix", LENGTH, lambda o: o.skd.prefixes.mean, "mean prefix distance, φ cut at the duration of ψ, m",
           _SKD, "prefix distance", _MORE, by_phi=lambda o: o.skd.prefixes.interval, independent="ci95_pairs",
           plain=lambda o: o.skd.prefixes.plain_interval, bare=True, per_phi=True, clustered=True, summary=12,
           difference=4, campaign=16, sweep=7),
    Figure("variance", Kind(ref("number_or_null"), "m²"), lambda o: o.skd.distances.variance,
           "sample variance of the Fréchet distance, m²", _SKD, campaign=17, sweep=8),
    Figure("plans_deviation", FLAG, lambda o: o.plan.limits_deviation,
           "whether these kamikazes plan for the deviation; else for the Fréchet distance", _OBJECTIVE),
    Figure("pairs", COUNT, lambda o: int(o.skd.distances.values.size), "pairs (φ, ψ) whose trial ended in a collision",
           _SKD, per_phi=True, campaign=18, sweep=9),
    Figure("discarded_by_distance", COUNT, lambda o: o.skd.discarded,
           "pairs further apart than maximum_distance, left out", _SKD),
    Figure("probability_bound", _each(ref("rate")), lambda o: o.bounds(),
           "η (m) → Theorem 1's upper bound of P(distance ≤ η) by these kamikazes", _SKD),
    Figure("probability_bound_ci95", _each(INTERVAL.schema), lambda o: o.bound_intervals(),
           "95 % interval of each over φ", _SKD),
    Figure("kamikaze_success_rate", SHARE, lambda o: o.success_rate.value,
           "success rate of the kamikazes whose SKD is reported", _SKD,
           "of the trials of SKD collide", _LESS, **_RATE, bare=True,
           source="success_rate", clustered=True, summary=10, campaign=19, sweep=10, compare=20),
    Figure("kamikaze_trials", COUNT, lambda o: o.trials, "kamikaze episodes, aborted ones left out", _SKD,
           source="trials"),
    Figure("kamikaze_aborted", COUNT, lambda o: len(o.reasons), "kamikaze episodes that were aborted", _SKD,
           source="aborted"),
    Figure("success_rate", SHARE, lambda o: o.success_rate.value,
           "share of the trials that reached what they planned for: a hit, or a collision", _OBJECTIVE,
           **_RATE, better=_LESS, clustered=True),
    Figure("trials", COUNT, lambda o: o.trials, "kamikaze episodes, aborted ones left out", _OBJECTIVE),
    Figure("failed", COUNT, lambda o: o.trials - o.success_rate.hits, "trials that did not reach what they planned for",
           _OBJECTIVE),
    Figure("aborted", COUNT, lambda o: len(o.reasons), "kamikaze episodes that were aborted", _OBJECTIVE),
    Figure("mean_impact_speed", SPEED, lambda o: o.mean_of(lambda log: log.impact_speed),
           "speed of the car at the contact, m/s", _SKD, "mean impact speed of these", details=1),
    Figure("mean_closing_speed", SPEED, lambda o: o.mean_of(closing_speed),
           "speed of the car relative to the road user at the contact, m/s", _SKD, "mean closing speed of these",
           details=3),
    Figure("standing_contacts", COUNT, lambda o: standing_contacts(o.collisions),
           "collisions with a car below 0.1 m/s", _OBJECTIVE),
    Figure("aborted", COUNT, lambda a: len(a.reasons), "episodes that were aborted, of all kinds", campaign=22),
    Figure("aborted_reasons", _each(ref("aborted_reason")), lambda a: counted_reasons(a.reasons),
           "aborted episodes by kind: how many, and the reason of the first"),
    Figure("commands_clipped", Kind(ref("commands_clipped")),
           lambda a: {"commands": sum(a.clipped), "episodes": len(a.clipped)},
           "commands beyond what the car can do, and episodes with such"),
    Figure("simulator_contacts", Kind(ref("simulator_contacts")), lambda a: simulator_contacts(a.logs),
           "contacts by the shapes of a simulator that has its own, beside those by SKD's geometry, which count",
           optional=True),
    Figure("simulation", Kind(ref("simulation")), lambda a: a.simulation and dict(a.simulation),
           "a simulator back end's description of the car in it; here the keys of MetaDrive's",
           recomputed=False, optional=True),
    Figure("command_age", Kind(or_null(ref("command_age"))), lambda a: command_age(a.logs),
           "of episodes through the graph: wall time (s) from a command to its use, or from a state to its answer",
           recomputed=False),
    Figure("nominal_collision_rate", SHARE, lambda a: a.nominal_collision_rate.value,
           "share of the runs along φ that the moving car hit", by_phi=lambda a: a.nominal_collision_rate.interval,
           label="nominal collision rate", better=_LESS, summary=2, first=True, chart=2, difference=5, campaign=8,
           compare=12, junit=4),
    Figure("contact_rate", SHARE, lambda a: a.contact_rate.value, "share of the runs along φ that ended in a collision",
           by_phi=lambda a: a.contact_rate.interval, independent="ci95_runs",
           plain=lambda a: a.contact_rate.plain_interval, label="contact rate along φ, any touch",
           better=_LESS, clustered=True, summary=11, difference=6, campaign=14, sweep=11, compare=18, junit=9),
    Figure("clustering", Kind(ref("clusterings")), lambda a: a.clustering(),
           "what the intervals over φ are made of, by figure"),
    Figure("clustering", Kind(ref("clusterings_of_objective")), lambda o: o.clustering(),
           "what the intervals over φ are made of, by figure", _OBJECTIVE),
    Figure("until_width", Kind(or_null(ref("until_width"))), lambda a: a.until_width and a.until_width.as_dict(),
           "sequential stopping; null: not requested", recomputed=False),
    Figure("collision_runs", COUNT, lambda a: a.contact_rate.trials, "runs along φ, aborted ones left out"),
    Figure("lane_left", SHARE, lambda a: (a.lanes_left or (None,))[0],
           "share of the runs along φ in which a corner of the car is beyond its lane; missing: in none",
           label="leaves its lane along φ", recomputed=False, details=10, optional=True),
    Figure("lane_left_time", TIME, lambda a: (a.lanes_left or (None, None))[1],
           "mean time that a corner is beyond its lane in these runs, s", label="time out of its lane in these",
           recomputed=False, details=11, optional=True),
    Figure("collision_standing_contacts", COUNT, lambda a: standing_contacts(a.nominal_runs),
           "of these, collisions with a car below 0.1 m/s"),
    Figure("left_out", LINES, lambda a: list(a.left_out), "recordings that were left out, and why",
           recomputed=False),
    Figure("warnings", LINES, lambda a: list(a.warnings), "warnings, a line each", recomputed=False),
    Figure("static_tests", _typed("array", items=ref("static_test")), lambda a: list(a.static_tests),
           "what came of the protocol's static tests, of each impact place that one of the φ stands for",
           recomputed=False, optional=True),
    Figure("name", TEXT, None, "name of φ", Of.PHI),
    Figure("trials", COUNT, None, "kamikaze episodes on it, aborted ones included", Of.PHI),
    Figure("failed", COUNT, None, "of these, without a hit or collision", Of.PHI),
    Figure("aborted", COUNT, None, "of these, aborted", Of.PHI),
    Figure("contact_rate", SHARE, None, "share of the runs along it that ended in a collision", Of.PHI_TOP),
    Figure("collision_runs", COUNT, None, "runs along it, aborted ones left out", Of.PHI_TOP),
    Figure("safe", FLAG, None, "whether φ is safe with this car: not hit in nearly all runs along it", Of.PHI_TOP),
    Figure("distinct_safe_trajectories", COUNT, lambda a: len({one.positions.tobytes() for one in a.safe}),
           "how many φ differ from one another"),
    Figure("per_safe_trajectory", _typed("array", items=ref("safe_trajectory")), lambda a: a.per_safe_trajectory(),
           "figures of each φ, in their order"),
    Figure("per_safe_trajectory", _typed("array", items=ref("safe_trajectory_of_objective")),
           lambda o: o.per_safe_trajectory(), "figures of each φ, in their order", _OBJECTIVE),
    Figure("objectives", _typed("object", minProperties=1, additionalProperties=ref("objective")),
           lambda a: a.objectives, "all figures of the kamikazes of each objective"),
    Figure("surrogate_measures", Kind(ref("surrogate_measures")), lambda a: a.surrogates.as_dict(),
           "surrogate safety measures of the episodes: median and worst; they are no rating"),
    Figure("vulnerability_curve", Kind(or_null(ref("vulnerability_curve"))),
           lambda a: a.vulnerability and a.vulnerability.as_dict(),
           "share of trials with a hit within a deviation of eta, m; null: no kamikazes of objective deviation"),
    Figure("seconds", Kind(ref("number"), "s"), lambda a: round(a.seconds, 3),
           "wall-clock time of the command, of a sweep of this car, s", _SETTING, recomputed=False, campaign=24),
    Figure("seed", COUNT, lambda a: a.plan.seed, "of all random draws", _SETTING, compare=22, junit=10),
    Figure("car", TEXT, lambda a: a.plan.car.label, "name of the car in tables", _SETTING,
           recomputed=False),
    Figure("controller", TEXT, lambda a: a.plan.controller, "as on the command line", _SETTING, recomputed=False),
    Figure("multiplier", NUMBER, lambda a: a.plan.car.stated_multiplier, "C of the basic controller", _SETTING,
           recomputed=False),
    Figure("safe", TEXT, lambda a: a.plan.safe, "where φ are from", _SETTING, recomputed=False),
    Figure("simulations", _typed("integer", minimum=1), lambda a: a.plan.simulations,
           "of the planner in each decision", _SETTING, recomputed=False),
    Figure("maximum_distance", LENGTH, lambda a: a.plan.maximum_distance,
           "pairs further apart are left out, m; null: none are", _SETTING),
    Figure("adversary_model", Kind({"enum": ["generic", "learned", "exact"]}),
           lambda a: str(a.plan.resolved_adversary_model), "what the adversary knows of the car", _SETTING,
           recomputed=False, compare=14, junit=6),
    Figure("options", _typed("object"), lambda a: further_options(a.plan),
           "further options that were not as by default", _SETTING, recomputed=False),
    Figure("car_model", _typed("object", "null"),
           lambda a: json.loads(a.plan.car_model) if a.plan.car_model else None,
           "learned model of the car, as in its file; null: none", _SETTING, recomputed=False),
    Figure("scenario", _typed("object", required=["name", "time_step", "eta_max"]),
           lambda a: a.plan.scenario.as_dict(),
           "as in its YAML file: m, s, rad; frame map (x East across the road, y North along it)", _SETTING,
           recomputed=False),
    Figure("version", TEXT, lambda _a: version(), "of SKD", _SETTING, recomputed=False, compare=23, junit=11),
    Figure("provenance", Kind(or_null(ref("provenance"))), lambda a: a.stated_provenance(),
           "what ran, when and where", _SETTING, recomputed=False),
)  # fmt: skip

AT_THE_TOP = {one.key: one for one in FIGURES if one.of not in (Of.OBJECTIVE, Of.PHI, Of.PHI_TOP)}
"""The rows that stand at the top of assessment.json, by key."""
OF_OBJECTIVES = {one.key: one for one in FIGURES if one.of in (Of.RANKING, Of.SKD, Of.OBJECTIVE) and not one.source}
"""Those that stand under each objective."""
OF_PHI = {one.key: one for one in FIGURES if one.per_phi or one.of is Of.PHI}
"""Those that stand in the rows of each φ."""


def keys_of(*of: Of) -> tuple[str, ...]:
    """Return the keys at the top of the figures of some, intervals included."""
    return tuple(key for one in AT_THE_TOP.values() if one.of in of for key in one.keys)


def entries(rows: Collection[Figure], subjects: Mapping[Of, Any]) -> dict[str, Any]:
    """Return what stands under the keys of rows, in their order: null where there is no such subject.

    Args:
        rows: of the table.
        subjects: what computes them, by whose they are; None: it is not known.
    """
    found = {key: value for one in rows for key, value in one.entries(subjects[one.of])}
    empty = [one.key for one in rows if one.optional and not found[one.key]]
    return {key: value for key, value in found.items() if key not in empty}


def shown_in(output: str) -> list[Figure]:
    """Return the figures that an output has, in its order."""
    found = [one for one in FIGURES if getattr(one, output)]
    return sorted(found, key=lambda one: int(getattr(one, output)))


def columns(output: str) -> tuple[str, ...]:
    """Return the keys of the figures that an output has side by side, in its order, with those of their intervals."""
    return tuple(key for one in shown_in(output) for key in (one.keys[:1] if one.bare else one.keys))


def figures_html(figures: Mapping[str, Any], warnings: Sequence[str] = ()) -> str:
    """Return the figures that are looked at first, with their intervals, as a table.

    Args:
        figures: content of assessment.json.
        warnings: why they are not credible, a line each.
    """
    known = [one for one in shown_in("summary") if isinstance(figures.get(one.key), (int, float))]
    rows = "".join(_row(one, figures) for one in known)
    what = f"{figures['car']} in {figures['scenario']['name']}"
    head = "<tr><th></th><th>value</th><th>95 % interval</th></tr>"
    said = "".join(f"<br>{html.escape(line)}" for line in warnings)
    return f"<table><caption>{html.escape(what)}{said}</caption>{head}{rows}</table>"


def _row(one: Figure, figures: Mapping[str, Any]) -> str:
    value, interval = figures[one.key], figures.get(f"{one.key}_ci95")
    ends = "" if interval is None or None in interval else f"[{_shown(one, interval[0])}, {_shown(one, interval[1])}]"
    return f"<tr><td>{html.escape(one.heading)}</td><td>{_shown(one, value)}</td><td>{ends}</td></tr>"


def _shown(one: Figure, value: float) -> str:
    return f"{one.kind.scale * value:.{one.kind.digits}f}"
