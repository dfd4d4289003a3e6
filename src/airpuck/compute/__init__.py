"""Execution of array programs: compilation, XLA, sines, precision, cores.

Entry points: `compiled.program`, `compiled.for_batches`, `compiled.for_samples`.
"""
