"""Options of PETSc's multigrid preconditioners that suit filtered Hessians."""

from __future__ import annotations

from typing import Any

#: Shift of a zero diagonal, relative to Young's modulus: negligible beside a stiffness.
_SHIFT = 1e-10


def smoothers(E: float) -> dict[str, Any]:
    """Return PETSc options that make multigrid's smoothers SOR sweeps.

    For the displacement, and for the displacement's block of a saddle-point problem. PETSc's
    default is a Chebyshev polynomial up to an estimated largest eigenvalue; a filtered Hessian may
    have larger ones, and the preconditioner is then indefinite. An aggregate of one node has fewer
    unknowns than there are rigid motions, so the coarser matrix has a zero on its diagonal, which
    is shifted.

    Parameters
    ----------
    E : float
        Young's modulus [Pa]; of several materials the smallest.
    """
    sweeps = {"ksp_type": "richardson", "pc_type": "sor", "pc_sor_diagonal_shift": _SHIFT * E}
    blocks = ("", "fieldsplit_u_")
    return {f"{b}mg_levels_{key}": value for b in blocks for key, value in sweeps.items()}
