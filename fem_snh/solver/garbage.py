"""Free the PETSc objects of problems that are no longer used.

petsc4py does not destroy an object when Python drops it, as ranks may drop objects in different
orders: it is kept until ``PETSc.garbage_cleanup`` is called for its communicator. Every mesh and
matrix of dolfinx has a communicator of its own, which a program cannot ask for once the problem is
dropped. So communicators are recorded when a solver is created.
"""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import ref

from mpi4py import MPI
from petsc4py import PETSc


class _Record(NamedTuple):
    """A problem and the communicators of its PETSc objects."""

    problem: ref[Any]
    comms: list[PETSc.Comm]


_records: list[_Record] = []


def record(problem: Any, *objects: PETSc.Object) -> None:
    """Record the communicators of a problem's PETSc objects, for `free_unused`. Collective."""
    # A duplicate is PETSc's own communicator with one more reference: it outlives the problem.
    _records.append(_Record(ref(problem), [found.comm.duplicate() for found in objects]))


def free_unused(comm: MPI.Comm) -> None:
    """Destroy the PETSc objects to which no rank of ``comm`` refers any longer. Collective.

    Objects of other groups of ranks are left to the calls with their communicators.
    """
    _clean([PETSc.COMM_SELF])  # each rank's own, as the factors of a coarse matrix
    for found in [r for r in _records if _same_ranks(r.comms[0].tompi4py(), comm)]:
        _clean(found.comms)  # a SNES, which refers to its problem
        unused = comm.allreduce(found.problem() is None, op=MPI.LAND)
        _clean(found.comms)  # the objects of the problem
        if unused:
            for each in found.comms:
                each.destroy()
            _records.remove(found)


def _clean(comms: list[PETSc.Comm]) -> None:
    """Destroy the objects of these communicators that all ranks have dropped. Collective."""
    for comm in comms:
        PETSc.garbage_cleanup(comm)


def _same_ranks(first: MPI.Comm, second: MPI.Comm) -> bool:
    """Return whether two communicators have the same ranks, in the same order."""
    return MPI.Comm.Compare(first, second) in (MPI.IDENT, MPI.CONGRUENT)
