#!/usr/bin/env bash
# Runs a command with ROS 2, the project's environment and its workspace in place.
set -eo pipefail
top=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
. "/opt/ros/${ROS_DISTRO:-jazzy}/setup.bash"
. "$top/.venv-${ROS_DISTRO:-jazzy}/bin/activate"
. "$top/ros_ws/install/setup.bash"
exec "$@"
