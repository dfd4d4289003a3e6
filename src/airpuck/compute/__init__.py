"""How array programs run: compilation, XLA, sines, precision, cores. No other room knows of it."""
