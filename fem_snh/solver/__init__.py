"""Newton's method with projected Hessians, as a PETSc SNES.

`create` configures it for a problem, `ProjectedNewton` is its context, `Directions`, `LineSearch`
and `Predictor` are its parts. ``-snes_view``, monitors, converged reasons and options work as for
PETSc's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any

from petsc4py import PETSc

from fem_snh._petsc import OUT_OF_MEMORY, default_options, factors_out_of_memory
from fem_snh.choices import HESSIANS
from fem_snh.errors import BadInput, Failed, choose
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.solver import saddle_point, trust_region
from fem_snh.solver.direction import Directions, Iteration
from fem_snh.solver.line_search import LineSearch
from fem_snh.solver.newton import ProjectedNewton
from fem_snh.solver.predictor import Predictor

__all__ = [
    "Directions", "EisenstatCG", "Iteration", "LineSearch", "Predictor", "ProjectedNewton",
    "create", "failures", "linear_solver", "out_of_memory", "own_errors", "reason", "smoothers",
    "usual", "why",
]  # fmt: skip

PREFIX = "snh_"


def create(problem: Any, hessian: str = "adaptive", prefix: str = PREFIX) -> PETSc.SNES:
    """A SNES that minimises ``problem``'s energy, configured from PETSc's options. Collective.

    Defaults: `EisenstatCG`, deflated; of a saddle MINRES with a block fieldsplit; where ``trust``
    calls its region, options under ``trust_``, Steihaug's CG with incomplete Cholesky factors,
    blocks of each rank. With an option ``ksp_type`` or ``pc_type`` all is PETSc's own, from CG with
    Jacobi on. Linear tolerance between 1e-3 and 0.1 (Eisenstat-Walker), 200 iterations. Where a
    step starts far away (the twist), so loose a solve lets rounding, and so the number of ranks,
    decide the path: ``-snes_forcing_max 5e-3`` makes it repeatable.

    Raises BadInput for an option's bad value.
    """
    energy_scale = problem.force_scale * problem.length
    has_energy = problem.material.expression.has_energy
    database = PETSc.Options(prefix)
    policy = database.getString("snes_hessian", hessian)
    context = ProjectedNewton(
        problem.jacobian, problem.force_scale, energy_scale, has_energy, problem.saddle_point
    )
    context.options["snes_hessian"] = choose("hessian", hessian, HESSIANS)
    snes = PETSc.SNES().create(problem.comm)
    snes.setOptionsPrefix(prefix)
    snes.setType(PETSc.SNES.Type.PYTHON)
    snes.setPythonContext(context)
    if has_energy:
        snes.setObjective(lambda snes, x: problem.energy(x))
    snes.setFunction(lambda snes, x, f: problem.residual(x, f), problem.x.duplicate())
    snes.setJacobian(context.jacobian, problem.A)
    snes.setTolerances(rtol=0.0, atol=0.0, stol=0.0, max_it=200)
    # It is iterations that are limited: corrections, too, evaluate the function.
    snes.setMaxFunctionEvaluations(2**31 - 1)
    ksp = snes.getKSP()
    ksp.setTolerances(rtol=1e-3, atol=0.0, max_it=20000)
    if problem.saddle_point:
        saddle_point.configure(ksp, problem.A, problem.saddle_point)
    elif not (database.hasName("ksp_type") or database.hasName("pc_type")):
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(EisenstatCG(problem.coordinates))
        ksp.getPC().setType(PETSc.PC.Type.NONE)
    else:
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.getPC().setType(PETSc.PC.Type.JACOBI)
    ours = (
        saddle_point.BLOCKS
        if problem.saddle_point
        else trust_region.OPTIONS
        if policy == "trust"
        else {}
    )
    try:
        with own_errors(), default_options(prefix, ours):
            snes.setFromOptions()
            if problem.saddle_point and ksp.getPC().getType() == PETSc.PC.Type.FIELDSPLIT:
                ksp.getPC().setUp()  # the parts read their options, once
            if policy == "trust":
                context.within_region = trust_region.linear_solver(problem.A, prefix)
    except PETSc.Error as error:
        raise BadInput(f"PETSc rejects an option under -{prefix}: {error}") from None
    return snes


def linear_solver(snes: PETSc.SNES) -> str:
    """Its linear solver and preconditioner, in two words of PETSc's."""
    ksp = snes.getKSP()
    ours = isinstance(ksp.getPythonContext(), EisenstatCG) if ksp.getType() == "python" else False
    return "cg+ssor" if ours else f"{ksp.getType()}+{ksp.getPC().getType()}"


def usual(problem: Any) -> str:
    """The policy for the Hessian where nothing is said: ``trust`` where there is a least energy."""
    least = problem.has_energy and not problem.saddle_point
    return "trust" if least else "adaptive"


def smoothers(E: float) -> dict[str, Any]:
    """PETSc options of multigrid's smoothers, of the displacement and of a saddle's: sweeps.

    PETSc's own is a polynomial for eigenvalues up to an estimated one; where a filtered Hessian has
    larger ones, it makes the preconditioner indefinite. An aggregate of one node has fewer unknowns
    than there are rigid motions, so a zero on the diagonal of the coarser matrix: the shift, of
    nothing beside a stiffness with Young's modulus ``E`` [Pa].
    """
    sweeps = {"ksp_type": "richardson", "pc_type": "sor", "pc_sor_diagonal_shift": 1e-10 * E}
    blocks = ("", "fieldsplit_u_")
    return {f"{b}mg_levels_{key}": value for b in blocks for key, value in sweeps.items()}


@contextmanager
def own_errors() -> Iterator[None]:
    """Let what our callbacks raise (BadInput, Ctrl-C) through PETSc as it is.

    Newer petsc4py's raise a PETSc.Error from it.
    """
    try:
        yield
    except PETSc.Error as error:
        cause: BaseException = error
        while isinstance(cause, PETSc.Error) and cause.__cause__ is not None:
            cause = cause.__cause__
        if isinstance(cause, PETSc.Error):
            raise
        raise cause from None


@contextmanager
def failures() -> Iterator[None]:
    """What PETSc cannot go on from, or memory that ran out, as `Failed`: in one line."""
    try:
        yield
    except MemoryError as error:
        raise Failed(f"out of memory ({str(error) or 'an array'})") from error
    except PETSc.Error as error:
        if error.ierr == OUT_OF_MEMORY:
            raise Failed("out of memory (PETSc)") from error
        last = str(error).strip().splitlines()[-1].partition("] ")[2]
        raise Failed(f"PETSc error {error.ierr}: {last or error}") from error


def reason(snes: PETSc.SNES) -> str:
    """Why the last solve ended, by PETSc's name: "CONVERGED_FNORM_ABS", "DIVERGED_MAX_IT"..."""
    return _name(PETSc.SNES.ConvergedReason, snes.getConvergedReason())


def why(snes: PETSc.SNES) -> str:
    """`reason`, and what is behind it: "DIVERGED_LINEAR_SOLVE: DIVERGED_INDEFINITE_PC".

    Collective.
    """
    said, linear = reason(snes), snes.getKSP().getConvergedReason()
    if snes.getConvergedReason() < 0 and not isfinite(snes.getSolution().norm()):
        return f"{said}: NaN or infinity in the unknowns"
    if snes.getConvergedReason() != PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
        return said
    if out_of_memory(snes):
        return f"{said}: the factors do not fit into memory"
    if linear >= 0:
        return f"{said}: no direction down"
    return f"{said}: {_name(PETSc.KSP.ConvergedReason, linear)}"


def out_of_memory(snes: PETSc.SNES) -> bool:
    """Whether the last solve failed as its preconditioner's factors took too much memory."""
    failed = snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
    return failed and factors_out_of_memory(snes.getKSP().getPC())


def _name(reasons: Any, code: int) -> str:
    names = {v: k for k, v in vars(reasons).items() if isinstance(v, int)}
    return names.get(code, str(code))
