"""Contact of a body with itself, and of the bodies of one mesh with each other."""
