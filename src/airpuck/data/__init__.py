"""Trajectories, windows, and commands held between events."""
