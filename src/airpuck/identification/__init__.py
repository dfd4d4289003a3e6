"""Trajectory -> model."""
