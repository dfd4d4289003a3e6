"""Trajectories, windows, and commands held between events.

Entry points: `windows.make_windows`, `trajectory.hold`.
"""
