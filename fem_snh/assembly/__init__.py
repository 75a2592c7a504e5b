"""Unknowns and matrices: elements, numbering, matrix layout, loops over cells, conditions."""
