"""The simulated table.

Entry points: `plant.build_plant`, `puck.PuckOnTable`.
"""
