"""Model x trajectory -> errors.

Entry points: `goodness.goodness`, `innovations.innovations`.
"""
