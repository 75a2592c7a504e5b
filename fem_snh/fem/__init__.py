"""Finite elements: meshes, elements, numbering, assembly, the problem and its energy terms.

`problem` puts together what the other modules provide; a solver sees nothing else of them.
"""
