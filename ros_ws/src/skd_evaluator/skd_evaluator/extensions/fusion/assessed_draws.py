"""Margin and risk of a car in a calibrated simulator, with what is not known of the simulator in their intervals.

Parameters of the simulator are drawn from what the calibration knows of them; with each draw the same φ, trials and
walkers are assessed. What is said is the mean over the draws; its interval is that of the mixture of all draws, each of
which counts as normal to either side by its own interval (over φ). So it holds both: other φ of this kind, and other
values of the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special
from skd_sim.options.adversary import Knowledge, Objective
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress
from skd_evaluator.assessment.options import WALKERS
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.dask_cluster import make_runner
from skd_evaluator.assessment.stages.checks import fresh_process
from skd_evaluator.assessment.stages.pipeline import assess_in_process
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.metrics.aborted import NOT_CREDIBLE, not_credible, too_many_aborted
from skd_evaluator.metrics.margins import stopped_at

TRIALS, RUNS = 2, 125
"""Trials on each φ of the margin, and runs along φ, four crossings for each of which the risk has."""
_NORMAL = 1.959963984540054
_PARTS = 4000  # quantiles by which a draw enters the mixture


@dataclass(frozen=True)
class Propagated:
    """A figure over draws of the parameters.

    Attributes:
        key: of assessment.json.
        value: mean over draws.
        interval: of 95 %, with what is not known of φ and of the parameters.
        by_phi: mean width of the intervals over φ of single draws: what knowing the parameters would leave.
        values: of each draw.
    """

    key: str
    value: float
    interval: tuple[float, float]
    by_phi: float
    values: tuple[float, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return its entry in simulator.json."""
        return {
            "value": self.value,
            "ci95": list(self.interval),
            "mean_width_by_phi": self.by_phi,
            "draws": list(self.values),
        }


def assessed_draws(
    worlds: Sequence[Scenario],
    car: CarUnderTest,
    safe: Mapping[str, np.ndarray],
    seed: int,
    workers: int,
    progress: Progress,
) -> list[dict[str, Any]]:
    """Return the content of assessment.json of a car in each of some worlds, on the same φ and with the same draws.

    Args:
        worlds: scenarios.
        car: that is assessed.
        safe: positions of each φ by name, m.
        seed: of the assessments.
        workers: number of processes.
        progress: called with what is being done, how much of it is done, and out of how much.
    """
    found = []
    for number, scenario in enumerate(worlds):
        progress("draws of the simulator", number, len(worlds))
        plan = Plan(
            scenario,
            seed=seed,
            controller=car.controller,
            multiplier=car.multiplier,
            safe_count=len(safe),
            kamikaze_count=TRIALS,
            collision_runs=RUNS,
            objective=Objective.DEVIATION,
            knowledge=None if car.is_own and car.has_multiplier else Knowledge.NOTHING,
        )
        runner = make_runner(None, workers, isolated=not car.is_own)
        ways = [Trajectory(positions, scenario.time_step, name) for name, positions in safe.items()]
        context = Context(runner, runner, (plan.objective,), risk=risk_request(WALKERS), fresh=fresh_process)
        found.append(assess_in_process(context, Assessment(plan, tuple(ways))).as_dict())
    progress("draws of the simulator", len(worlds), len(worlds))
    return found


def propagated(figures: Sequence[Mapping[str, Any]], key: str, limits: tuple[float, float]) -> Propagated | None:
    """Return a figure over draws; None where one of them does not have it.

    Args:
        figures: content of assessment.json of each draw.
        key: of the figure; its interval stands under the same with `_ci95`.
        limits: numbers between which it lies.
    """
    if any(one.get(key) is None or one.get(f"{key}_ci95") is None for one in figures):
        return None
    values = np.array([float(one[key]) for one in figures])
    ends = np.array([one[f"{key}_ci95"] for one in figures], dtype=float)
    standard = special.ndtri((np.arange(_PARTS) + 0.5) / _PARTS)
    below, above = (values - ends[:, 0]) / _NORMAL, (ends[:, 1] - values) / _NORMAL
    spread = np.where(standard[None, :] < 0.0, below[:, None], above[:, None])
    mixed = np.clip(values[:, None] + standard[None, :] * spread, *limits)
    low, high = np.quantile(mixed, [0.025, 0.975])
    interval = float(min(low, values.mean())), float(max(high, values.mean()))
    return Propagated(key, float(values.mean()), interval, float(np.ptp(ends, axis=1).mean()), tuple(values.tolist()))


def draw_warnings(figures: Sequence[Mapping[str, Any]], maximum_aborted: float) -> list[str]:
    """Return what a reader should know of figures over draws, a line each, as of those of one assessment.

    Args:
        figures: content of assessment.json of each draw.
        maximum_aborted: share of a draw's episodes that may be aborted.
    """
    count = len(figures)
    found = list(dict.fromkeys(line for one in figures for line in not_credible(one["warnings"])))
    for what, key, note in (("margin", "margin", "margin_note"), ("risk", "risk_1", "risk_note")):
        if unknown := [one for one in figures if one[key] is None]:
            why = unknown[0][note] or "no reason is given"
            found.append(f"the {what} is not said: in {len(unknown)} of {count} draws it is not known ({why})")
    searched = [one for one in figures if one["margin"] is not None]
    if loose := [one for one in searched if not one["margin_converged"]]:
        longest = max(loose, key=lambda one: int(one["margin_budget"]))
        found.append(
            f"in {len(loose)} of {count} draws the search for the margin {stopped_at(longest)}: the margin may be less"
        )
    if beyond := [one for one in searched if one["margin_beyond"]]:
        trials, every = (sum(one[key] for one in searched) for key in ("margin_beyond", "margin_trials"))
        found.append(
            f"in {len(beyond)} of {count} draws nobody could be hit within η_max ({beyond[0]['eta_max']:g} m) in "
            f"trials of which the margin is made, {trials} of {every} in all; they count as η_max: the margin may "
            "be more"
        )
    if aborted := [one for one in figures if one["aborted"]]:
        kind, reasons = next(iter(aborted[0]["aborted_reasons"].items()))
        line = (
            f"{sum(one['aborted'] for one in aborted)} episodes in {len(aborted)} of {count} draws were aborted "
            f"({reasons.get('first') or kind}); they count in no figure"
        )
        found.append(
            f"{NOT_CREDIBLE}{line}" if any(too_many_aborted(one, maximum_aborted) for one in aborted) else line
        )
    return [" ".join(line.split()) for line in found]
