"""Experiment design: what to fly next, so that the next fit is more accurate.

Entry point: `design.design`.
"""
