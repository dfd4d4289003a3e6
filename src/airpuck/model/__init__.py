"""Models: the table of quantities, the rungs, and models with their files.

Entry points: `model_file.published_model`, `rungs.named_rung`, `uncertainty.Uncertainty`,
`simulation.linearize`.
"""
