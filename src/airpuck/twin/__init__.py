"""The simulated table.

Entry points: `plant.build_plant`, `twin.Twin`.
"""
