"""Flights: real, simulated and replayed.

Entry points: `loop.fly`, `loop.Link`.
"""
