"""One interface to dolfinx 0.5, 0.9 and 0.11; no other part of the package imports dolfinx.

Functions have one signature for all versions. They detect features and compare no version numbers;
a comment at each workaround names the versions that need it.

Local numbering, as in dolfinx: the entities and nodes a rank owns come first, ghosts after them.
Meshes made by `create_mesh` have no ghost cells, so each rank's cells are the ones it owns.
"""

from __future__ import annotations

import dolfinx

from fem_snh._dolfinx.element_kernels import integrals, kernel_arguments, pack
from fem_snh._dolfinx.facets import FACET_OF, exterior_facets, facet_maps
from fem_snh._dolfinx.forms import (
    add_vector,
    assemble_matrix,
    assemble_scalar,
    assemble_vector,
    create_matrix,
    create_vector,
    form,
    interpolate,
    petsc_vec,
)
from fem_snh._dolfinx.meshes import (
    cell_facets,
    cell_name,
    cell_vertices,
    coordinates,
    create_mesh,
    geometry_degree,
    geometry_dofs,
    geometry_x,
    gmsh_permutation,
    input_cells,
    input_nodes,
    input_vertices,
    num_cells,
    num_exterior_facets,
    num_nodes_of_degree,
    num_owned,
    read_xdmf,
    read_xdmf_nodes,
    read_xdmf_tags,
    reference_corners,
    reference_edges,
    reference_facets,
    write_xdmf,
)
from fem_snh._dolfinx.newton import newton_solver, prescribed
from fem_snh._dolfinx.points import bounding_box, locate
from fem_snh._dolfinx.programs import (
    bc_dofs,
    bc_space_is_within,
    count_entities,
    has_real_values,
    is_function,
    is_lagrange,
    is_measure,
    measure_entities,
    mesh_dimension,
    set_bcs,
)
from fem_snh._dolfinx.spaces import (
    cell_measures,
    constant,
    degree,
    facet_nodes,
    function,
    function_space,
    local_to_global,
    locate_dofs,
    node_dofs,
    num_components,
    num_nodes,
    quadrature,
    reference_nodes,
    surface_measure,
    surface_measures,
    tabulate,
    tabulate_element,
    tabulate_geometry,
    tabulate_geometry_values,
    tabulate_values,
    vtk_mesh,
)

version: str = dolfinx.__version__

__all__ = [
    "FACET_OF", "add_vector", "assemble_matrix", "assemble_scalar",
    "assemble_vector", "bc_dofs", "bc_space_is_within", "bounding_box", "cell_facets",
    "cell_measures", "cell_name", "cell_vertices", "constant", "coordinates", "count_entities",
    "create_matrix", "create_mesh", "create_vector", "degree", "exterior_facets", "facet_maps",
    "facet_nodes", "form", "function", "function_space", "geometry_degree", "geometry_dofs",
    "geometry_x", "gmsh_permutation", "has_real_values", "input_cells", "input_nodes",
    "input_vertices", "integrals", "interpolate", "is_function", "is_lagrange",
    "is_measure", "kernel_arguments", "local_to_global", "locate", "locate_dofs",
    "measure_entities", "mesh_dimension", "newton_solver", "node_dofs", "num_cells",
    "num_components", "num_exterior_facets", "num_nodes", "num_nodes_of_degree", "num_owned",
    "pack", "petsc_vec", "prescribed", "quadrature", "read_xdmf", "read_xdmf_nodes",
    "read_xdmf_tags", "reference_corners", "reference_edges", "reference_facets",
    "reference_nodes", "set_bcs", "surface_measure",
    "surface_measures", "tabulate", "tabulate_element", "tabulate_geometry",
    "tabulate_geometry_values", "tabulate_values", "version", "vtk_mesh", "write_xdmf",
]  # fmt: skip
