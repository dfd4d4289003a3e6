"""What is known before any flight: the vehicle and the table.

Entry points: `table.Table`, `table.read_table`.
"""
