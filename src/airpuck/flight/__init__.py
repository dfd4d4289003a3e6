"""Flights: real, simulated and replayed."""
