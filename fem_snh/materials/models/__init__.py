"""The energies, one a file: a module with a function of the same name (see `fem_snh.materials`)."""
