"""What holds for all tests.

A suite that a shell started in the background ignores SIGINT, and so would every program that a test interrupts.
Hypothesis tries the same examples in each run and does not mind how long one takes; new ones are tried with
`--hypothesis-profile=explore`.
"""

from __future__ import annotations

import signal

from hypothesis import HealthCheck, settings

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")
