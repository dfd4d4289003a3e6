"""What comes from a user and goes back: limits, the one error, TOML, files replaced in one step.

Entry points: `files.Section`, `files.replacing`.
"""
