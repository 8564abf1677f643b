"""What options ask of the risk: by which behaviour model, and by how many crossings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from skd_sim.errors import UsageError

from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.assessment.plan.options import NO_BEHAVIOUR
from skd_evaluator.metrics.behaviour.model import Behaviour, file_of, load_behaviour

NOT_ASKED: Final = f"--behaviour {NO_BEHAVIOUR}: the risk was not asked for"


@dataclass(frozen=True)
class RiskAsked:
    """What is asked.

    Attributes:
        behaviour: the behaviour model; None: there is to be no risk.
        runs: crude crossings at each scale; None: as many as is usual.
        subset: whether there is subset simulation of a car that is not known, too.
    """

    behaviour: Behaviour | None = None
    runs: int | None = None
    subset: bool = False


NOTHING_ASKED: Final = RiskAsked()


def risk_asked(behaviour: str, runs: int | None = None, *, subset: bool = False) -> RiskAsked:
    """Return what options ask.

    Raises:
        UsageError: there is no such behaviour model, or it was changed in the folder in which it was written; or the
            risk is not asked for, and how to find it is.
    """
    if behaviour != NO_BEHAVIOUR:
        return RiskAsked(behaviour_asked(behaviour), runs, subset)
    if runs is not None or subset:
        option = "--risk-subset" if runs is None else f"--risk-runs {runs}"
        raise UsageError(f"{option}: --behaviour {NO_BEHAVIOUR} asks for no risk; leave one of them away")
    return NOTHING_ASKED


def behaviour_asked(name: str) -> Behaviour:
    """Return the behaviour model of a name, file or folder, as `skd behaviour fit` wrote it.

    Raises:
        UsageError: there is no such behaviour model, or it was changed in the folder in which it was written.
    """
    behaviour = load_behaviour(name)
    check_unchanged(file_of(name).parent, [file_of(name).name])
    return behaviour
