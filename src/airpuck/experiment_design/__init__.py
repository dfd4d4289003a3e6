"""What to fly next, so that the next fit knows more."""
