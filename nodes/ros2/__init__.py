"""The node that puts a chain on a ROS 2 graph, and the two ways onto it: rclpy where it is there, Cyclone DDS otherwise."""
