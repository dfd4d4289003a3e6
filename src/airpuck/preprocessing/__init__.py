"""From a recording to a trajectory: subsec:data_preprocessing.

Entry points: `pipeline.preprocess`, `pipeline.load_trajectory`, `quality.left_out_words`.
"""
