"""How array programs run: compilation, XLA, sines, precision, cores. No other package knows of it.

Entry points: `compiled.program`, `compiled.for_batches`, `compiled.for_samples`.
"""
