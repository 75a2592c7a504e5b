"""Accuracy against cost on a scene: elements, meshes and solver settings measured together.

Modules
-------
knobs : the settings that are varied ("knobs"), and their values.
grid : the combinations that are run.
reference : the reference solution, and how accurate it is.
errors : the errors of all rows.
advice : recommended settings, as sentences and as a table.
study : the whole study.
"""
