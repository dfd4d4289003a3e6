"""The user boundary: limits, the one error class, TOML files, atomic replacement of files.

`numbers` has the limits of numbers, `limits` the limits of files.

Entry points: `files.Section`, `outputs.replacing`.
"""
