"""A game on the ROS 2 graph: its score, and a human on the twin's table."""
