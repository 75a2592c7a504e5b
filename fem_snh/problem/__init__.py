"""The boundary value problem of a scene or of a dolfinx program, with its conditions."""
