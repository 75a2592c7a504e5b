"""The fields of a run's output: names, components, units, and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

#: Names of components, in the order of the values: of vectors; of 3x3 tensors, row by row, as
#: ParaView expects tensors of 9 components; of principal values.
VECTOR = ("x", "y", "z")
TENSOR = tuple(i + j for i in VECTOR for j in VECTOR)
PRINCIPAL = ("1", "2", "3")
#: How the names begin of the fields that have the error of a goal in each cell, at a run's end.
ERRORS = "error_"


class OutputField(NamedTuple):
    """A field of the output.

    Attributes
    ----------
    label : str
        The field's name beside a colour bar.
    unit : str
        The field's unit, if the scene is in SI units.
    components : tuple of str
        Names of the components; empty for a scalar.
    meaning : str
        A description for tables and messages.
    nonnegative : bool
        Whether no component can be negative. Colour scales then start at 0.
    """

    label: str
    unit: str
    components: tuple[str, ...] = ()
    meaning: str = ""
    nonnegative: bool = False


#: The field with the number of each cell's part of the mesh; run.json has the parts' names.
CELL_GROUP = "cell_group"
#: The fields that every run writes, if its problem has them.
STANDARD = {
    "displacement": OutputField("displacement u", "m", VECTOR, "displacement of the nodes"),
    "J": OutputField("J  (volume ratio)", "", (), "volume ratio det F, mean over the cell"),
    "min_J": OutputField(
        "smallest J at a quadrature point", "", (),
        "smallest volume ratio det F at a quadrature point of the cell",
    ),
    CELL_GROUP: OutputField(
        "cell group", "", (),
        "number of the cell's groups and material in `cell_groups` of run.json; of meshes with "
        "several",
    ),
    "energy_density": OutputField(
        "energy density", "Pa", (), "energy per reference volume, mean", True
    ),
    "min_eigenvalue": OutputField(
        "smallest eigenvalue of the Hessian", "Pa", (),
        "smallest eigenvalue of the energy density's Hessian in the cell",
    ),
    "pressure": OutputField(
        "pressure unknown p", "Pa", (),
        "pressure unknown of a Taylor-Hood element, positive in tension",
    ),
}  # fmt: skip

#: The fields that a scene's key ``fields`` names.
ON_REQUEST = {
    "cauchy_stress": OutputField("Cauchy stress", "Pa", TENSOR, "sigma = P F^T / J"),
    "von_mises": OutputField(
        "von Mises stress", "Pa", (), "sqrt(3/2 s : s), s the deviator of the Cauchy stress", True
    ),
    "principal_stresses": OutputField(
        "principal stress", "Pa", PRINCIPAL,
        "eigenvalues of the Cauchy stress, the largest first",
    ),
    "hydrostatic_stress": OutputField(
        "hydrostatic stress", "Pa", (), "tr(sigma) / 3, positive in tension"
    ),
    "pk1_stress": OutputField(
        "first Piola-Kirchhoff stress P", "Pa", TENSOR, "P = d psi / d F, force per reference area"
    ),
    "green_lagrange_strain": OutputField(
        "Green-Lagrange strain", "", TENSOR, "E = (F^T F - I) / 2"
    ),
    "principal_stretches": OutputField(
        "principal stretch", "", PRINCIPAL,
        "singular values of F, the largest first; the third is negative where J < 0",
    ),
    "reaction_force": OutputField(
        "reaction force", "N", VECTOR,
        "force of the constraint on each constrained node, 0 at the others; the sum over points "
        "is the total, as one rank's file has the force of a shared node and the others have 0",
    ),
}  # fmt: skip

#: The fields that only a scene with [time] may name.
IN_TIME = {
    "velocity": OutputField("velocity", "m/s", VECTOR, "velocity of the nodes; with [time]"),
    "acceleration": OutputField(
        "acceleration", "m/s^2", VECTOR, "acceleration of the nodes; with [time]"
    ),
}
#: The fields that only a scene with contact may name.
CONTACT_PRESSURES = {
    "contact_pressure": OutputField(
        "contact pressure", "Pa", (),
        "force per area of the deformed surface, in plane stress of the reference thickness: "
        "normal force with [[obstacle]], magnitude with [self_contact]", True,
    ),
    "nominal_contact_pressure": OutputField(
        "nominal contact pressure", "Pa", (),
        "the same per reference area of the surface", True,
    ),
}  # fmt: skip
#: The fields that only a scene with obstacles may name, and those of contact.
AT_OBSTACLES = CONTACT_PRESSURES | {
    "gap": OutputField(
        "gap", "m", (), "signed distance from the closest obstacle; with [[obstacle]]"
    ),
}  # fmt: skip
#: All fields that a scene may name.
NAMED = ON_REQUEST | IN_TIME | AT_OBSTACLES

#: Names of the fields that are at the nodes always.
NODAL = ["reaction_force", *IN_TIME, *AT_OBSTACLES]
#: Names of the nodal fields whose sum over the nodes has a meaning. Ranks that share a node each
#: write it: the file of the node's owner has the value, the other files have 0.
SUMMED = ("reaction_force",)
#: The locations that a scene may choose for the fields that are not in `NODAL`.
LOCATIONS = ("cells", "nodes")


def add_nodal_fields(fields: Mapping[str, OutputField]) -> None:
    """Add nodal fields, of a feature of another package, to `NODAL` and `NAMED`."""
    NODAL.extend(name for name in fields if name not in NAMED)
    NAMED.update(fields)
