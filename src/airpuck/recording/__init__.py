"""Reading and writing of a lab's recordings.

Entry points: `read.read_recording`, `mapping.read_mapping`, `mapping.RecordingMapping`,
`stream.Recording`, `torch_archive.read_authors_experiment`.
"""
