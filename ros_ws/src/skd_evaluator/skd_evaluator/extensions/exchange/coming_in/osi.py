"""Ways out of ASAM OSI ground truth in MCAP: where the middle of each moving object's bounding box is, by its id."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.errors import UsageError

from skd_evaluator.bags.mcap_file import Condition, Received, read_messages
from skd_evaluator.extensions.exchange.coming_in.found import Found, listed, track_of
from skd_evaluator.extensions.exchange.names import EGO, SOURCE
from skd_evaluator.extensions.exchange.osi_library import osi_messages

SCHEMA = "osi3.GroundTruth"
_NANOSECONDS = 1e-9
_MOST_ROWS = 5_000_000


def read_osi(path: Path) -> list[Found]:
    """Return every moving object; one that SKD has exported bears its name there, any other its id.

    Raises:
        UsageError: the library is not installed, the file is damaged, a message is none of ground truth, or several
            topics have some, whose ids need not be of the same objects.
    """
    kind = osi_messages().GroundTruth
    condition, count = Condition(), 0
    rows: dict[int, list[tuple[float, float, float]]] = {}
    roles: dict[int, str] = {}
    kinds: dict[int, str] = {}
    topics: dict[str, None] = {}
    for received in read_messages(path, lambda _topic: True, condition):
        if received.schema.name != SCHEMA:
            continue
        topics[received.channel.topic] = None
        if len(topics) > 1:
            raise UsageError(f"{path}: has ground truth on {listed(list(topics))}; give a file with one of them")
        message = _parsed(kind, received, path)
        time = message.timestamp.seconds + _NANOSECONDS * message.timestamp.nanos
        for one in message.moving_object:
            number = int(one.id.value)
            count += 1
            if count > _MOST_ROWS:
                raise UsageError(f"{path}: has more than {_MOST_ROWS} states of objects; cut it to what is wanted")
            rows.setdefault(number, []).append((time, one.base.position.x, one.base.position.y))
            if number not in roles:
                roles[number] = _role(one) or (EGO if message.host_vehicle_id.value == number else str(number))
                kinds[number] = _kind(one)
    if condition.damage:
        raise UsageError(f"{path}: is damaged ({condition.damage[0]})")
    if not rows:
        raise UsageError(f"{path}: has no moving object in ground truth of OSI")
    if len(set(roles.values())) < len(roles):  # two that say they are the same
        roles = {number: str(number) for number in roles}
    found = []
    for number, states in rows.items():
        table = np.array(states, np.float64)
        if len(table) >= 2:
            track = track_of(table[:, 0], table[:, 1:], f"{path}, {roles[number]}")
            found.append(Found(roles[number], track, kinds[number]))
    return found


def _parsed(kind: Any, received: Received, path: Path) -> Any:
    try:
        message = kind()
        message.ParseFromString(received.data)
    except Exception as error:  # google.protobuf's DecodeError, and whatever damaged bytes make it raise
        raise UsageError(f"{path}: a message on {received.channel.topic} is no ground truth of OSI") from error
    return message


def _role(found: Any) -> str:
    """Return what SKD has called an object; empty if it has not."""
    for one in found.source_reference:
        if one.type == SOURCE and len(one.identifier):
            return str(one.identifier[0])
    return ""


def _kind(found: Any) -> str:
    for one in found.source_reference:
        if one.type == SOURCE and len(one.identifier) > 1:
            return str(one.identifier[1])
    if found.type == found.TYPE_VEHICLE:
        return str(found.vehicle_classification.Type.Name(found.vehicle_classification.type))
    return str(found.Type.Name(found.type))
