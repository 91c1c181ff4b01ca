"""The ROS 2 bridge node, through rclpy if installed, or Cyclone DDS."""
