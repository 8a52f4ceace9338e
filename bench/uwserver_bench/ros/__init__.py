"""The benchmark of ROS."""
