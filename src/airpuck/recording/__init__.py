"""Reading and writing what a lab has.

Entry points: `read.read_recording`, `torch_archive.read_authors_experiment`, `mapping.Topics`.
"""
