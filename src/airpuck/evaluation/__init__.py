"""Model x trajectory -> errors."""
