"""Several craft on one table: paths agreed between them, flown on the twin or the real table."""
