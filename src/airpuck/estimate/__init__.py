"""From past poses and commands to the present state and actuation.

Entry points: `kalman.KalmanFilter`, `actuation.ActuationEncoder`.
"""
