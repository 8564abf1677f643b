"""Between which reference drivers the car stands, by their margins in the same trials (`--reference`).

Margins of reference drivers are searched for as those of any car: some ten seconds for each driver. They are kept in
the user's cache, beside those of basic cars, under the hash of all that they depend on, so that the next car in these
trials has them at once.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from skd_sim.controllers.controller import with_control_period
from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json
from skd_sim.kernels.compilation import cache_folder
from skd_sim.options.car_and_adversary import REFERENCE_DRIVERS, WORLD, AdversaryModel, CarUnderTest
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress, stage
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.stages.margin import minimal_deviations
from skd_evaluator.errors import AssessmentError
from skd_evaluator.files import replace_file
from skd_evaluator.margin.basic_margins import margins_key
from skd_evaluator.metrics.margins import Margins, ReferenceMargin, difference
from skd_evaluator.version import version

MOST_TRIALS = 60
"""In which the drivers are compared."""


@stage(75)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the margins of all reference drivers in the car's first trials, where requested."""
    margins = assessment.margins
    if not context.reference or margins is None:
        return assessment
    each = min(len(margins.per_phi[0]), math.ceil(MOST_TRIALS / len(assessment.safe)))
    own = [np.minimum(one[:each], margins.eta_max) for one in margins.per_phi]
    found, warnings = [], list(assessment.warnings)
    for name in REFERENCE_DRIVERS:
        try:
            theirs, converged = _margins(_plan_of(assessment.plan, name), assessment.safe, each, context)
        except (AssessmentError, UsageError) as error:
            warnings.append(f"not compared with reference driver {name}: {error}")
            continue
        compared = difference(own, theirs)
        if compared is None or compared.ci95 is None:
            warnings.append("not compared with reference drivers: that needs two safe trajectories")
            break
        bounds = not margins.converged, not converged
        found.append(
            ReferenceMargin(name, float(np.mean(theirs)), compared.mean, compared.ci95, compared.trials, bounds)
        )
    return replace(assessment, reference=tuple(found), warnings=tuple(warnings))


def _plan_of(plan: Plan, name: str) -> Plan:
    """Return the plan with a reference driver in the place of the car, in SKD's own world."""
    period = CarUnderTest(name).kind.control_period
    scenario = with_control_period(replace(plan.scenario, control_period=None), period, name)
    known = AdversaryModel.GENERIC  # nothing is planned
    return replace(plan, scenario=scenario, controller=name, adversary_model=known, car_model="", simulator=WORLD)


def _margins(plan: Plan, safe: Sequence[Trajectory], each: int, context: Context) -> tuple[list[FloatArray], bool]:
    """Return a driver's margins in the first trials of each φ (m), and whether the search for them has converged."""
    driver = [plan.controller, context.margin_limit, version()]
    file = cache_folder().with_name("margins") / f"{margins_key(plan.scenario, safe, plan.seed, each, driver)}.json"
    with contextlib.suppress(UsageError, KeyError, TypeError, ValueError):
        kept = read_json(file)
        values = np.array(kept["margins"], dtype=np.float64)
        if values.shape == (len(safe), each) and (values >= 0.0).all():
            return list(values), bool(kept["converged"])
    hits, search = minimal_deviations(
        plan.trials(safe, each), {}, context.workers, _labelled(context, plan.controller), context.margin_limit
    )
    found = Margins((tuple(hits),), plan.scenario.eta_max, search)
    values = found.values.reshape(len(safe), each)
    with contextlib.suppress(OSError, UsageError):
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_file(file, json.dumps({"margins": values.tolist(), "converged": found.converged}))
    return list(values), found.converged


def _labelled(context: Context, name: str) -> Progress:
    return lambda label, done, total: context.progress(f"{label}, {name}", done, total)
