"""Conversion between ROS messages and the objects of SKD."""
