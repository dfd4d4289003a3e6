"""Trajectories, windows, and commands held between events.

Entry points: `windows.make_windows`, `zero_order_hold.hold`.
"""
