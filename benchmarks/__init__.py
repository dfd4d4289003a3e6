"""The speeds stated in the README and docs/results.md, measured by one command.

python -m benchmarks
"""
