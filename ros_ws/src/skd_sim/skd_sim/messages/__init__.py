"""Messages of ROS from and to what SKD computes with."""
