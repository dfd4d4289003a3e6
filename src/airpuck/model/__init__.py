"""The physics: pure functions of state, input and parameters.

Entry points: `model_file.published_model`, `rungs.named_rung`, `uncertainty.Uncertainty`.
"""
