"""Detection of motor faults, and checks of the vehicle file's motor layout.

Entry points: `find.find_faults`, `layout_check.check_layout`, `strengths.find_strengths`.
"""
