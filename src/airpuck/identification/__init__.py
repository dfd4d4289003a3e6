"""Trajectory -> model.

Entry points: `objective.PredictionLoss`, `bootstrap.bootstrap`.
"""
