"""Where ROS 2 comes from: the one that is sourced, or wheels that are added to this environment once."""
