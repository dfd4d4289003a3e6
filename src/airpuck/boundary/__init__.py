"""What comes from a user and goes back: limits, the one error, TOML, files replaced in one step.

`numbers` has the limits of numbers, `limits` the limits of files.

Entry points: `files.Section`, `outputs.replacing`.
"""
