"""A suite that a shell started in the background ignores SIGINT, and so would every program that a test interrupts."""

from __future__ import annotations

import signal

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
