"""The thin ROS 2 side of the package; the only modules in it that import rclpy or messages."""
