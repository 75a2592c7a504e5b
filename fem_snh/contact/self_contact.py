"""The choice of a method of self-contact, of which the term of a problem is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from fem_snh.choices import SELF_CONTACT_METHODS
from fem_snh.errors import bad_value, choose

if TYPE_CHECKING:
    from fem_snh.assembly.regions import Region
    from fem_snh.mesh.mesh import Mesh
    from fem_snh.terms.term import Term


@dataclass(frozen=True)
class SelfContact:
    """Contact of a body with itself, and of the bodies of one mesh with each other.

    It is one of the ``terms`` of a :class:`fem_snh.nonlinear_problem.NonlinearProblem`.

    Parameters
    ----------
    method : {"reference", "ipc"}
        ``reference``: springs that push samples of the surface out of deformed cells, to the
        closest point in the reference configuration (Smith et al. 2018, section 6); bodies may
        intersect at the start. ``ipc``: a barrier, with which the surface never intersects itself
        (Li et al. 2020); it needs the package ipctk, and no start that intersects.
    stiffness : float, optional
        ``reference``: contact pressure over penetration [Pa/m]; default: 50 E over the size of the
        cells. ``ipc``: stiffness of the barrier [Pa]; default: a tenth of the materials' modulus.
    distance : float, optional
        ``ipc``: distance at which contact begins [m].
    friction : float, optional
        ``ipc``: coefficient of friction.

    Raises
    ------
    BadInput
        For an unknown method, and for values that the method does not have.
    """

    method: str = "reference"
    stiffness: float | None = None
    distance: float | None = None
    friction: float = 0.0

    def __post_init__(self) -> None:
        choose("self_contact.method", self.method, SELF_CONTACT_METHODS)
        for key, lowest in (("stiffness", 0.0), ("distance", 0.0)):
            value = getattr(self, key)
            if value is not None and not value > lowest:
                raise bad_value(f"self_contact.{key}", value, "a number above 0")
        if not self.friction >= 0:
            raise bad_value("self_contact.friction", self.friction, "a number of at least 0")
        if self.method == "reference" and (self.distance is not None or self.friction):
            key = "friction" if self.friction else "distance"
            accepted = "no value, as the method is reference"
            raise bad_value(f"self_contact.{key}", getattr(self, key), accepted)

    def create_term(self, V: Any, regions: Sequence[Region], mesh: Mesh | None = None) -> Term:
        """Return the term; only its own method is imported. Collective.

        Parameters
        ----------
        V : dolfinx function space
            The displacement's space.
        regions : sequence of Region
            The materials.
        mesh : Mesh, optional
            The mesh, whose skin touches itself if it has one. Default: that of ``V``, without one.

        Raises
        ------
        BadInput
            On every rank, without materials, if ipctk is missing, or as the method says.
        """
        if not regions:
            raise bad_value("terms", "self-contact", "a material: its modulus scales the contact")
        body: Any = SimpleNamespace(domain=V.mesh, skin=None) if mesh is None else mesh
        if self.method == "reference":
            from fem_snh.contact.reference.reference import ReferenceContact

            return ReferenceContact(V, body, regions, self.stiffness)
        from fem_snh.contact.barrier import IPC

        return IPC(V, body, regions, self.stiffness, self.distance, self.friction)
