"""A secret that whoever starts a process hands to it, and that is not to be found beside it.

It stands neither in the arguments nor in the environment, which every process of the same user can read: it comes by
standard input, and is gone once it is read. Light: programs begin with it.
"""

from __future__ import annotations

import functools
import os

FROM_INPUT = "SKD_SECRET_FROM_INPUT"
"""Variable that tells a process how many bytes of a secret come by its standard input."""


@functools.cache
def handed_secret() -> bytes | None:
    """Return the secret that this process was handed; None if it was handed none.

    Raises:
        RuntimeError: another process has read it.
    """
    size = int(os.environ.pop(FROM_INPUT, "0"))
    secret = b""
    while len(secret) < size and (more := os.read(0, size - len(secret))):
        secret += more
    if len(secret) < size:
        raise RuntimeError("another process has read what was handed to this one")
    return secret or None
