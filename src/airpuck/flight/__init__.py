"""Flights: real, simulated and replayed.

Entry points: `loop.fly`, `loop.Pilot`, `link.Link`.
"""
