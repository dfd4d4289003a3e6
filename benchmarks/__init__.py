"""The speeds stated in the README and benchmarks/README.md, measured by one command.

python -m benchmarks
"""
