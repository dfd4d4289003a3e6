"""Identification: from trajectories to a model.

Entry points: `structure.identify`, `problem.Loss`, `problem.Preparation`, `bootstrap.bootstrap`,
`objective.PredictionLoss`.
"""
