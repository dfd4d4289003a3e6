"""Which parts of a recording a model of a healthy craft must not be learned from."""
