"""What a result is worth: indicators of locking and inversion, and their notes."""
