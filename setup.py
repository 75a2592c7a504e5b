"""The list of packages. pyproject.toml cannot map the folder meshes/ to fem_snh.meshes as well."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["fem_snh", "fem_snh.*"]), "fem_snh.meshes"],
    package_dir={"fem_snh.meshes": "meshes"},
    package_data={"": ["*.geo", "include/*.h", "py.typed", "page.*", "words.toml"]},
)
