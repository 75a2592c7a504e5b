"""Contact with rigid obstacles: gap, normal force, friction, and their output."""
