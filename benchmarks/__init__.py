"""What the README and docs/results.md say about speed, measured by one command.

python -m benchmarks
"""
