"""What a result is worth: estimated errors of goals; locking, inversion, and notes."""
