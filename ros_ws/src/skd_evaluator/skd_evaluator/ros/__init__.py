"""The evaluator in the node graph: its node, the processes it starts, its domain. All of ROS that the package knows."""
