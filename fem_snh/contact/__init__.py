"""Contact with obstacles, other bodies and itself: surfaces, search, law, friction."""
