"""Energy terms, and the features that create them.

A problem holds only the terms that its scene or program names. `fem_snh.terms.term.Term` is the
interface of a term. A `fem_snh.terms.feature.Feature` is a table of a scene, or an object of a
program, that creates a term. Reading a scene imports features only, so this file imports nothing.
"""
