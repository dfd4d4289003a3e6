"""Flying on a ROS 2 graph: the twin, the controller and the recorder as processes.

Entry points: `graph.Graph`.
"""
