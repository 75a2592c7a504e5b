"""One interface to dolfinx 0.5, 0.9 and 0.11; no other part of the package imports dolfinx.

Functions have one signature for all versions. They detect features and compare no version numbers;
a comment at each workaround names the versions that need it.

Local numbering, as in dolfinx: the entities and nodes a rank owns come first, ghosts after them.
Meshes made by `create_mesh` have no ghost cells, so each rank's cells are the ones it owns.
"""

# ruff: noqa: F401
from __future__ import annotations

import dolfinx
from dolfinx.fem import Function, FunctionSpace
from dolfinx.mesh import Mesh

from fem_snh._dolfinx.element_kernels import integrals, kernel_arguments, pack
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
    FACET_OF,
    bounding_box,
    cell_facets,
    cell_name,
    cell_vertices,
    coordinates,
    create_mesh,
    exterior_facets,
    facet_maps,
    facet_reflections,
    geometry_degree,
    geometry_dofs,
    geometry_x,
    gmsh_permutation,
    input_cells,
    input_nodes,
    input_vertices,
    locate,
    num_cells,
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
    prescribed,
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
