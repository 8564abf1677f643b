"""Episodes that only the nodes of one graph can read: whoever else listens learns neither mode nor φ nor seed.

A car under test that knows whether it is being attacked can be another car then. So an evaluator that starts its nodes
itself gives them a key, and what it announces on `/skd/episode` is shut: plain are the stamp, the campaign, the
controller, its seed and the scenario, which a car may know; the whole message stands in `sealed`, by AES-256 in
Galois/Counter Mode (NIST SP 800-38D), which also tells who announces without the key.
"""

from __future__ import annotations

import copy
import hashlib
import hmac
import os
from array import array
from typing import Any, Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from rclpy.serialization import deserialize_message, serialize_message
from skd_msgs.msg import Episode as EpisodeMsg

from skd_sim.errors import UsageError

KEY_SIZE: Final = 32  # bytes
_NONCE_SIZE: Final = 12  # bytes
SEALED_MODE: Final = 255
"""In place of the mode of an episode that is not told to everybody."""
_PLAIN: Final = ("header", "campaign", "controller", "multiplier", "scenario", "controller_seed")


class Seal:
    """What the nodes of one graph share; without a key all is said openly."""

    def __init__(self, key: bytes | None = None) -> None:
        """Take the key, of 32 bytes."""
        self._key = key
        self._cipher = None if key is None else AESGCM(key)

    @property
    def is_open(self) -> bool:
        """Whether all is said openly."""
        return self._key is None

    def shut(self, message: Any, scenario: str = "") -> Any:
        """Return the Episode message that is published in place of another one.

        Args:
            message: the other one.
            scenario: text of the scenario that is said openly; by default the message's.
        """
        if self._cipher is None:
            return message
        shut = EpisodeMsg(mode=SEALED_MODE)
        for field in _PLAIN:
            setattr(shut, field, copy.copy(getattr(message, field)))
        shut.scenario = scenario or shut.scenario
        nonce = os.urandom(_NONCE_SIZE)
        # As an array: of any other sequence rosidl's own check looks at each byte.
        shut.sealed = array("B", nonce + self._cipher.encrypt(nonce, serialize_message(message), None))
        return shut

    def open(self, message: Any) -> Any:
        """Return the Episode message that was shut.

        Raises:
            UsageError: it was not shut with this key.
        """
        sealed = bytes(message.sealed)
        if self._cipher is None:
            if sealed:
                raise UsageError(
                    "the evaluator tells what this episode is to the nodes alone that it has started itself; "
                    "with --open-episodes it tells everybody"
                )
            return message
        try:
            data = self._cipher.decrypt(sealed[:_NONCE_SIZE], sealed[_NONCE_SIZE:], None)
        except (InvalidTag, ValueError):
            raise UsageError("it was announced by somebody who has not the evaluator's key") from None
        return deserialize_message(data, EpisodeMsg)

    def proof(self, digest: str) -> str:
        """Return what a receipt says in place of a digest, from which nobody without the key can tell what it is of."""
        return digest if self._key is None else hmac.new(self._key, digest.encode(), hashlib.sha256).hexdigest()
