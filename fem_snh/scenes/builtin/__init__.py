"""Built-in scenes: each module has a function of the same name that returns a Scene."""
