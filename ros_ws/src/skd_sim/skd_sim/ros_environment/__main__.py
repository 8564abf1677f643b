"""`python -m skd_sim.ros_environment [COMMAND…]`: see that ROS 2 is there, then become the command."""

from __future__ import annotations

import os
import sys

from skd_sim.errors import UsageError
from skd_sim.ros_environment.installation import ensure_ros, node_variables


def main() -> int:
    """Run the program; where a command is given it does not return."""
    try:
        ensure_ros()
    except UsageError as error:
        print(f"skd: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("skd: interrupted; the next graph command sets ROS 2 up anew", file=sys.stderr)
        return 130
    command = sys.argv[1:]
    if command:
        os.execvpe(command[0], command, node_variables(os.environ))
    return 0


if __name__ == "__main__":
    sys.exit(main())
