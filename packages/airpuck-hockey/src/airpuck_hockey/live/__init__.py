"""A human opponent for games on the ROS 2 graph."""
