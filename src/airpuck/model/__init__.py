"""The physics: pure functions of state, input and parameters."""
