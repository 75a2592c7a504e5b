"""Energy terms and the features that make them: each file has one.

A problem holds the terms that its scene names, and no others. `fem_snh.terms.term.Term` is their
interface; a `fem_snh.terms.feature.Feature` is a table of a scene, and an object of a program, that
makes one. Features are imported to read a scene, so this package imports nothing by itself.
"""
