"""Pages of a game in the browser: against a person, of two players, on a ROS 2 graph.

Entry points: `page.play_in_browser`, `page.watch_in_browser`.
"""
