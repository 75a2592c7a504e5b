"""Contact of a body with obstacles, other bodies and itself: tables, terms, laws, search."""
