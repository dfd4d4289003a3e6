"""The known properties of vehicle and table, before any flight.

Entry points: `table.Table`, `table.read_table`.
"""
