"""gmsh sources of the scenes' geometry: ``importlib.resources.files("fem_snh.meshes")``."""
