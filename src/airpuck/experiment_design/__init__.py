"""Experiment design: what to fly next, so that the next fit is more accurate.

Entry points: `design.design`, `design.check_design`.
"""
