"""Boundary value problems: conditions, bones, pressures; what a program or a scene solves."""
