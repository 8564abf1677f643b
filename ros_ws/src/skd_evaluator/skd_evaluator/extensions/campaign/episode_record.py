"""An episode as bytes: what happened, without loss to the last bit; and a digest of what it was specified to be."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.options.options import options_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.command_ages import Timing
from skd_sim.world.episode import Episode, EpisodeLog, Outcome
from skd_sim.world.trajectory import Trajectory

DIGEST_BYTES = 16
_HEAD = struct.Struct("<BddqqqdIIII")
"""Outcome, impact (time, speed), depletions, clipped, held, delay; lengths of states, belief, ages and reason."""
_OWN_CONTACT, _STRAYED = struct.Struct("<d"), struct.Struct("<dd")
_NOTHING_SAID = -1.0  # no time of a contact
"""Last, where the simulator said it: the time of the contact by its own shapes."""


def digest(*parts: bytes) -> bytes:
    """Return 16 bytes that no other parts have; each part is told from its neighbours."""
    found = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for part in parts:
        found.update(len(part).to_bytes(8, "little"))
        found.update(part)
    return found.digest()


def digest_of(content: Any) -> bytes:
    """Return the digest of plain data, whatever the order of its keys."""
    return digest(json.dumps(content, sort_keys=True, ensure_ascii=True).encode())


class Specifications:
    """Digests of episodes' specifications.

    Episodes of one assessment share scenario and φ: what these come to is computed once.
    """

    def __init__(self) -> None:
        """Know nothing yet."""
        self._known: dict[int, tuple[object, bytes]] = {}

    def digest(self, episode: Episode) -> bytes:
        """Return a digest of all that an episode's specification says."""
        phi = episode.safe_trajectory
        plain = [one.plain(getattr(episode, one.name)) for one in options_of(Episode)]
        plain += [int(episode.mode), episode.seed, episode.episode_id]
        parts = [self._of(episode.scenario), b"" if phi is None else self._of(phi), repr(plain).encode()]
        if episode.public is not None:  # few have another one than their own
            parts.append(self._of(episode.public))
        return digest(*parts)

    def _of(self, thing: Scenario | Trajectory) -> bytes:
        known = self._known.get(id(thing))
        if known is None or known[0] is not thing:
            found = digest_of(thing.as_dict()) if isinstance(thing, Scenario) else digest_of_trajectory(thing)
            known = self._known[id(thing)] = (thing, found)  # kept, so that nothing else gets its id
        return known[1]


def digest_of_trajectory(one: Trajectory) -> bytes:
    """Return a digest of a trajectory's positions, shape, time step and name."""
    positions = np.ascontiguousarray(one.positions, "<f8")
    return digest(positions.tobytes(), repr((positions.shape, float(one.time_step), one.name)).encode())


def to_bytes(log: EpisodeLog) -> bytes:
    """Return what happened in an episode; its specification is not part of it."""
    adversary, car = _floats(log.adversary, 2), _floats(log.car, 3)
    if len(adversary) != len(car):
        raise ValueError(f"{len(adversary)} places of the adversary and {len(car)} of the car")
    belief = np.empty((0, 4), "<f8") if log.belief is None else _floats(log.belief, 4)
    if log.belief is not None and len(belief) != len(adversary):
        raise ValueError(f"{len(adversary)} states and {len(belief)} rows of what was believed at them")
    ages = np.array(log.timing.ages, "<f8")
    reason = log.reason.encode("utf-8", "surrogatepass")
    head = _HEAD.pack(
        int(log.outcome), log.impact_time, log.impact_speed, log.depletions, log.clipped, log.timing.held,
        log.timing.delay, len(adversary), len(belief), len(ages), len(reason),
    )  # fmt: skip
    own = b"" if log.own_contact is None else _OWN_CONTACT.pack(log.own_contact)
    if log.strayed:
        own = _STRAYED.pack(_NOTHING_SAID if log.own_contact is None else log.own_contact, log.strayed)
    return b"".join((head, *(one.tobytes() for one in (adversary, car, belief, ages)), reason, own))


def from_bytes(data: bytes, episode: Episode) -> EpisodeLog:
    """Return the log of an episode; the inverse of `to_bytes`.

    Raises:
        ValueError: it is none.
    """
    try:
        outcome, time, speed, depletions, clipped, held, delay, states, believed, ages, reason = _HEAD.unpack_from(data)
    except struct.error as error:
        raise ValueError("it is too short") from error
    end = _HEAD.size + 8 * (5 * states + 4 * believed + ages) + reason
    if len(data) not in (end, end + _OWN_CONTACT.size, end + _STRAYED.size) or believed not in (0, states):
        raise ValueError("it is of another length than it says")
    own: float | None = None
    strayed = 0.0
    if len(data) == end + _STRAYED.size:
        own, strayed = _STRAYED.unpack_from(data, end)
        own = None if own == _NOTHING_SAID else own
    elif len(data) > end:
        (own,) = _OWN_CONTACT.unpack_from(data, end)
    sizes = np.cumsum([2 * states, 3 * states, 4 * believed])
    numbers = np.frombuffer(data, "<f8", int(sizes[-1]) + ages, _HEAD.size).astype(np.float64)
    adversary, car, belief, aged = np.split(numbers, sizes)
    return EpisodeLog(
        episode,
        Outcome(outcome),
        adversary.reshape(states, 2).copy(),
        car.reshape(states, 3).copy(),
        time,
        speed,
        depletions,
        data[end - reason : end].decode("utf-8", "surrogatepass"),
        clipped,
        Timing(tuple(aged.tolist()), held, delay),
        belief.reshape(believed, 4).copy() if believed else None,
        own,
        strayed,
    )


def _floats(array: npt.NDArray[np.float64], columns: int) -> npt.NDArray[np.float64]:
    if array.dtype != np.float64 or array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"states must be n × {columns} floats, got {array.dtype} of shape {array.shape}")
    return np.ascontiguousarray(array, "<f8")


def flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested mappings as one, with the keys in between joined by dots."""
    found: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found
