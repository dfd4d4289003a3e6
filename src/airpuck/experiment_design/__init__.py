"""What to fly next, so that the next fit knows more.

Entry points: `design.design`, `trials.check_design`.
"""
