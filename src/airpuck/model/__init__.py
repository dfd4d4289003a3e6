"""What is learned: the table of quantities, rungs, and models with their files.

Entry points: `model_file.published_model`, `rungs.named_rung`, `uncertainty.Uncertainty`,
`statespace.linearize`.
"""
