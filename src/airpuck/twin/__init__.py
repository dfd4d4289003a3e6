"""The simulated table.

Entry points: `plant.Plant`.
"""
