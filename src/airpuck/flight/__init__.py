"""Flights: real, simulated and replayed.

Entry points: `loop.fly`, `pilot.Pilot`, `link.Link`.
"""
