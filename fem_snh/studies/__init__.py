"""Studies: many runs, one tidy table."""
