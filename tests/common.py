"""What tests of several folders share: patience, and DDS domains of their own."""

from __future__ import annotations

import contextlib
import random
import socket
from collections import deque

PATIENCE = 300.0
"""s to wait for what must happen: a test that passes never waits so long, however busy the machine is."""

_reserved: deque[socket.socket] = deque()
_KEPT = 26  # as many as one test uses at once; older ones are free again, or a long run would use all of them up
_PARTICIPANTS = 8  # of one domain on this machine: each has a port


def new_domain() -> int:
    """A DDS domain that no other test uses, in this process or beside it, and in which nobody is."""
    reason: OSError | None = None
    for domain in random.SystemRandom().sample(range(1, 102), 101):
        guard = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            guard.bind(f"\0skd-test-domain-{domain}")
            with contextlib.ExitStack() as probes:
                for participant in range(_PARTICIPANTS):
                    probe = probes.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    probe.bind(("0.0.0.0", 7400 + 250 * domain + 10 + 2 * participant))
        except OSError as error:
            guard.close()
            reason = error
            continue
        _reserved.append(guard)
        if len(_reserved) > _KEPT:
            _reserved.popleft().close()
        return domain
    raise RuntimeError(f"every domain is in use ({reason})")
