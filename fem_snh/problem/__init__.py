"""Boundary value problems of scenes and programs: conditions, bones, pressures, vibrations."""
