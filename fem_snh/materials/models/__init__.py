"""The built-in energies: each module defines one function of its own name."""
