"""The formats that results go out in: how each is written, how its files end, and what it does not keep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from skd_evaluator.extensions.exchange.going_out.commonroad import write_commonroad
from skd_evaluator.extensions.exchange.going_out.openscenario import write_openscenario
from skd_evaluator.extensions.exchange.going_out.osi import osi_name, write_osi
from skd_evaluator.extensions.exchange.going_out.recorded import Recorded
from skd_evaluator.extensions.exchange.names import ADVERSARY, EGO
from skd_evaluator.extensions.exchange.osi_library import osi_messages, osi_writer
from skd_evaluator.extensions.fusion.recording import TABLE_CAR, TABLE_OTHER

_IDS = {EGO: TABLE_CAR, ADVERSARY: TABLE_OTHER}


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


def _write_csv(path: Path, recorded: Recorded) -> None:
    """Write an episode as csv: a row for each object at each time, as `skd fuse` reads two tracked objects.

    Its columns are t (s), id, x, y (m, of reference points), heading (rad) and speed (m/s).
    """
    lines = ["t,id,x,y,heading,speed"]
    for actor in recorded.actors:
        name = _IDS.get(actor.name, actor.name)
        for time, state in zip(actor.times.tolist(), actor.states.tolist(), strict=True):
            lines.append(",".join([repr(time), name, *map(repr, state)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


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
    "csv": Format(_write_csv, _ending("csv"), (_NEVER, "Road, shapes and kinds are not there.")),
}
