"""Evaluation: prediction errors and verdicts of a model on a trajectory.

Entry points: `evaluate.prediction_errors`, `fit_measures.measure_fit`, `innovations.innovations`,
`presentation.physical_thrust`.
"""
