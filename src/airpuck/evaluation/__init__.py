"""Model x trajectory -> errors.

Entry points: `evaluate.prediction_errors`, `fit_measures.measure_fit`, `gauge.physical_thrust`,
`innovations.innovations`, `verdict.verdict`.
"""
