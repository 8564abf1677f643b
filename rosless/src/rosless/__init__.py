"""The rclpy API over Eclipse Cyclone DDS, for machines where ROS 2 is not installed.

Node code never imports this package. It says ``import rclpy`` and ``from nav_msgs.msg import Odometry``;
where no rclpy is on the path, :mod:`rosless.activate` answers those imports from here.
"""
