"""Where the programs begin; `python -m skd_evaluator.start NAME` runs one."""

from __future__ import annotations

import sys
from functools import partial

from skd_sim.start import start, start_named

_INTERRUPTED = 130  # both have a task, which is then not done
_CLEANING = 3.0  # s: workers and a graph's processes have ended by then

evaluator = partial(start, "skd_evaluator.ros.evaluator_node", _INTERRUPTED)
skd = partial(start, "skd_evaluator.cli.main", _INTERRUPTED, _CLEANING)

if __name__ == "__main__":
    sys.exit(start_named({"evaluator": evaluator, "skd": skd}))
