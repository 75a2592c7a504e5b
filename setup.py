"""The packages, which pyproject.toml cannot say: those found and the gmsh sources, mapped in."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["fem_snh", "fem_snh.*"]), "fem_snh.meshes"],
    package_dir={"fem_snh.meshes": "meshes"},
    package_data={"": ["*.geo", "*.h", "include/*.h", "py.typed", "tables/*.csv"]},
)
