"""Everything finite element: meshes, elements, numbering, assembly, the problem and its terms."""
