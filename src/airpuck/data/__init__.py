"""Trajectories, windows, and commands held between events.

Entry points: `windows.make_windows`, `left_out.left_out_words`, `trajectory.hold`.
"""
