"""Flying on a ROS 2 graph: twin, controller, recorder and watcher as processes.

Entry points: `graph.Graph`, `process.LiveSettings`, `fly.fly_live`, `twin.serve_twin`.
"""
