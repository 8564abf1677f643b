"""An episode as csv: a row for each object at each time, the table of two tracked objects that `skd fuse` reads."""

from __future__ import annotations

from pathlib import Path

from skd_evaluator.exchange.going_out.recorded import Recorded
from skd_evaluator.exchange.names import ADVERSARY, EGO
from skd_evaluator.fusion.recording import TABLE_CAR, TABLE_OTHER

_IDS = {EGO: TABLE_CAR, ADVERSARY: TABLE_OTHER}


def write_csv(path: Path, recorded: Recorded) -> None:
    """Write an episode, with the columns t (s), id, x, y (m, of reference points), heading (rad) and speed (m/s)."""
    lines = ["t,id,x,y,heading,speed"]
    for actor in recorded.actors:
        name = _IDS.get(actor.name, actor.name)
        for time, state in zip(actor.times.tolist(), actor.states.tolist(), strict=True):
            lines.append(",".join([repr(time), name, *map(repr, state)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
