"""What a craft does against its model: effects of motors, timing, curve and floor.

Entry points: `effect_errors.effect_errors`, `window_regression.regress_windows`.
"""
