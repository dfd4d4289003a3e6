"""Commands, which airpuck finds by entry points."""
