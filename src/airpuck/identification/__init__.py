"""Identification: from trajectories to a model.

Entry points: `fit.identify`, `problem.Loss`, `problem.Preparation`, `objective.PredictionLoss`,
`bootstrap.bootstrap`, `selection.select_model`, `puck.identify_puck`.
"""
