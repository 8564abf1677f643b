"""Where the node's program begins; `python -m skd_adversary.start pedestrian_adversary` runs it."""

from __future__ import annotations

import sys
from functools import partial

from skd_sim.start import start, start_named

pedestrian_adversary = partial(start, "skd_adversary.nodes.pedestrian_adversary")

if __name__ == "__main__":
    sys.exit(start_named({"pedestrian_adversary": pedestrian_adversary}))
