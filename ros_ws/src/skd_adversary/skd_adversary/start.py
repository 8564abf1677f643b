"""Where the node's program begins; `python -m skd_adversary.start adversary` runs it."""

from __future__ import annotations

import sys
from functools import partial

from skd_sim.start import start, start_named

adversary = partial(start, "skd_adversary.ros.adversary_node")

if __name__ == "__main__":
    sys.exit(start_named({"adversary": adversary}))
