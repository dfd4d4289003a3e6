"""When motors did not follow their commands, and whether the vehicle file has them right.

Entry points: `find.find_faults`, `layout_check.check_layout`.
"""
