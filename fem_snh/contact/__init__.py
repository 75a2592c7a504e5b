"""Contact of a body with obstacles, with another body, and with itself."""
