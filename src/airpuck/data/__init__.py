"""Trajectories, windows, and commands held between events.

Entry points: `windows.make_windows`, `trajectory.left_out_words`, `trajectory.hold`.
"""
