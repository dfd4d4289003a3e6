"""The equations of motion: pure functions over an array namespace."""
