"""Why a margin that was found by whole episodes in another simulator may not be the car's, a line for each reason."""

from __future__ import annotations

from typing import Final

from skd_evaluator.campaign.plan.options import MAXIMUM_ABORTED
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.episode_search import WalkedMargins
from skd_evaluator.measure.doubt import DOUBT

_APART: Final = 0.01
"""m that a car may be elsewhere after the same ways: far more than a rounding, and less than any figure shows."""


def doubts_of_walking(walked: WalkedMargins, plan: Plan) -> tuple[str, ...]:
    """Return what a reader should know of a margin that another simulator's episodes have given, a line each.

    An aborted way is one on which nobody was hit, so where many are, there is no margin.

    Args:
        walked: what whole episodes have found.
        plan: the plan of the assessment, which says what the car is and where it drives.

    Raises:
        AssessmentError: more of the ways were aborted than may be.
    """
    lost = f"of {walked.episodes} ways that were walked {walked.aborted} were aborted"
    if walked.aborted > MAXIMUM_ABORTED * walked.episodes:
        raise AssessmentError(f"{lost} ({walked.reasons[0]})")
    found = []
    if walked.aborted:
        found.append(f"{DOUBT}in the search for the margin, {lost} ({walked.reasons[0]}): the margin may be less")
    if walked.repeated < walked.hits or walked.apart > _APART:
        who = f"simulator {plan.simulator}"
        if not plan.car.is_own:
            who += f", or controller {plan.controller},"
        found.append(
            f"{DOUBT}{who} does not repeat itself though it says that it does: of {walked.hits} ways of the margin "
            f"{walked.repeated} hit again when walked once more, and the car was up to {walked.apart:.2g} m elsewhere "
            "after the same commands"
        )
    return tuple(found)
