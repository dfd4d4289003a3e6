"""Reading and writing what a lab has.

Entry points: `read.read_recording`, `mapping.read_mapping`, `mapping.RecordingMapping`,
`stream.Recording`, `torch_archive.read_authors_experiment`.
"""
