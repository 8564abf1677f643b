"""The formats that results go out in: how each is written, how its files end, and what it does not keep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from skd_evaluator.exchange.going_out.commonroad import write_commonroad
from skd_evaluator.exchange.going_out.openscenario import write_openscenario
from skd_evaluator.exchange.going_out.osi import osi_name, write_osi
from skd_evaluator.exchange.going_out.recorded import Recorded
from skd_evaluator.exchange.going_out.table import write_csv
from skd_evaluator.exchange.osi_library import osi_messages, osi_writer


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        write: writes an episode into a file.
        name: returns the name of an episode's file.
        losses: what of an episode the format does not keep, or not as it was, a sentence each.
        whole_ticks: whether it knows states at whole time steps alone.
        with_road: whether the road is a file of its own, beside those of the episodes.
        check: raises a UsageError where a library that it needs is not installed.
    """

    write: Callable[[Path, Recorded], None]
    name: Callable[[Recorded], str]
    losses: tuple[str, ...]
    whole_ticks: bool = False
    with_road: bool = False
    check: Callable[[], object] = lambda: None


def _ending(suffix: str) -> Callable[[Recorded], str]:
    return lambda recorded: f"{recorded.stem}.{suffix}"


def _osi_is_there() -> None:
    osi_messages()
    osi_writer()


_NEVER = "The car's policy is in no format: a φ has the car's start alone, a kamikaze its recorded way."
FORMATS = {
    "openscenario": Format(
        write_openscenario,
        _ending("xosc"),
        (
            _NEVER,
            "A disc is the square about it.",
            "Lanes of crossing roads are roads of their own, without a junction.",
        ),
        with_road=True,
    ),
    "osi": Format(
        write_osi,
        osi_name,
        (
            _NEVER,
            "Times are whole nanoseconds.",
            "A disc is the square about it.",
            "Positions are those of the middle of boxes.",
        ),
        with_road=True,
        check=_osi_is_there,
    ),
    "commonroad": Format(
        write_commonroad,
        _ending("xml"),
        (
            _NEVER,
            "A kamikaze's last state is that of the tick in which the contact was, in which shapes overlap.",
            "Positions are those of the middle of boxes.",
            "Heights are not there.",
        ),
        whole_ticks=True,
    ),
    "csv": Format(write_csv, _ending("csv"), (_NEVER, "Road, shapes and kinds are not there.")),
}
