"""Contact between two surfaces of a mesh."""
