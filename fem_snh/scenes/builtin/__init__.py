"""The scenes of the package, one a file: a module with a function of the same name."""
