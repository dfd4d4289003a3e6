"""Flying on a ROS 2 graph: twin, controller, recorder, watcher and viewer as processes.

Entry points: `graph.Graph`, `process.LiveSettings`, `fly.fly_live`, `twin.serve_twin`,
`view.view_live`, `scene.Scene`.
"""
