"""From a recording to a trajectory: subsec:data_preprocessing.

Entry points: `pipeline.preprocess`, `pipeline.load_trajectory`.
"""
