"""Shared tools of the tests: each module states what it makes or checks."""
