"""Create the SNES of a problem, configured from PETSc's options."""

from __future__ import annotations

from petsc4py import PETSc

from fem_snh._petsc import default_options, expect_singular_matrix
from fem_snh.choices import DEFAULT_GLOBALIZATIONS, FACTORS_LBFGS_MAX_IT
from fem_snh.errors import BadInput
from fem_snh.linalg.direct_solver import (
    MAX_SMALL,
    is_factors_of_sum,
    set_direct_solver,
    set_direct_solver_of_sum,
)
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.solver import options, saddle_point
from fem_snh.solver.errors import callback_errors, cause_of, free_unused, record_solver
from fem_snh.solver.globalization import trust_region_solver
from fem_snh.solver.linear_choice import (
    CHOICES,
    AsymmetricSolver,
    LinearChoice,
    choose_linear_solver,
)
from fem_snh.solver.newton import ProjectedNewton
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.stability import EquilibriumStability, is_conservative

#: Prefix of the solver's options in PETSc's database.
PREFIX = "snh_"

#: Largest numbers of Newton iterations and of iterations of a linear solve (a saddle-point problem
#: has its own: `saddle_point.MAX_IT`).
_MAX_IT, _LINEAR_MAX_IT = 200, 20000
#: Relative tolerance of a linear solve near the solution; see `ForcingTerm`.
_LINEAR_RTOL = 1e-3
#: Limit of function evaluations, never reached: L-BFGS iterations evaluate the function too, so
#: only Newton iterations are limited.
_NO_LIMIT = 2**31 - 1


class NewtonSNES(PETSc.SNES):  # type: ignore[misc]  # petsc4py has no type hints
    """The SNES that `create` returns: it checks PETSc's options and counts linear iterations.

    PETSc's own count of linear iterations stays 0, as a SNES of type "python" cannot add to it.
    ``-snes_view`` prints this 0 below the true number, and the SNES that PETSc passes to a callback
    returns it.
    """

    def getLinearSolveIterations(self) -> int:
        """Return the linear iterations of the last solve."""
        return sum(iteration.linear for iteration in self.getPythonContext().history)

    def setFromOptions(self) -> None:
        """Read PETSc's options; raise BadInput for values that `options.check_petsc` rejects."""
        options.check_petsc(self.getOptionsPrefix(), self.getPythonContext().force_scale)
        super().setFromOptions()


def create(
    problem: SolvableProblem,
    hessian: str | None = None,
    globalization: str | None = None,
    prefix: str = PREFIX,
    examine_stability: bool = True,
) -> PETSc.SNES:
    """Return a SNES that solves ``problem``, configured from PETSc's options. Collective.

    Parameters
    ----------
    problem : SolvableProblem
    hessian : str, optional
        exact, clamp, abs or adaptive: see `SearchDirection`. The default is adaptive.
    globalization : str, optional
        linesearch or trust_region. The default is linesearch if ``hessian`` is given, otherwise
        `default_globalization`.
    prefix : str
        Prefix of the PETSc options: ``-snh_snes_hessian clamp`` replaces ``hessian``.
    examine_stability : bool, optional
        Whether the solver counts or leaves unstable equilibria; False if its end is no equilibrium,
        or is examined elsewhere.

    Raises
    ------
    BadInput
        For a value that an argument or an option does not accept.

    Notes
    -----
    `destroy` frees the SNES. Unless `choose_linear_solver` prefers sparse factors, the linear
    solver is `EisenstatCG` with deflation; for a saddle-point problem, flexible GMRES with a
    block-triangular preconditioner and `EisenstatCG` in its displacement block. Setting
    ``-ksp_type`` or ``-pc_type`` replaces `EisenstatCG` by PETSc's; the default is then CG with
    Jacobi. In the trust region the linear solver is Steihaug's CG with `SSOR`, with options under
    ``-trust_``. The relative tolerance of linear solves is between 1e-3 and 0.1 (`ForcingTerm`).
    Where a step starts far from the solution (the twist), the path of inexact solves depends on
    rounding, and so on the number of ranks; ``-snes_forcing_max 5e-3`` makes it repeatable.
    """
    free_unused(problem.comm)
    saddle = problem.saddle_point
    hessian, chosen = options.read_choices(prefix, hessian, globalization)
    globalization = chosen or default_globalization(problem)
    stability = examine_stability and is_conservative(problem)
    context = ProjectedNewton(problem, EquilibriumStability(problem) if stability else None)
    context.options = options.defaults_for(globalization) | {"snes_hessian": hessian}
    snes = NewtonSNES().create(problem.comm)
    snes.setOptionsPrefix(prefix)
    snes.setType(PETSc.SNES.Type.PYTHON)
    snes.setPythonContext(context)
    if problem.has_energy:
        snes.setObjective(lambda snes, x: problem.energy(x))
    snes.setFunction(lambda snes, x, f: problem.residual(x, f), problem.x.duplicate())
    snes.setTolerances(rtol=0.0, atol=0.0, stol=0.0, max_it=_MAX_IT)
    snes.setMaxFunctionEvaluations(_NO_LIMIT)
    ksp = snes.getKSP()
    context.linear_choice = _configure_linear_solver(ksp, problem, prefix)
    snes.setJacobian(context.jacobian, problem.operator, problem.P)
    if not problem.symmetric:
        context.asymmetric = AsymmetricSolver(problem, ksp, context.linear_choice)
    region = globalization == "trust_region"
    if region and context.linear_choice.direct:
        context.options["snes_lbfgs_max_it"] = float(FACTORS_LBFGS_MAX_IT)
    built_in = saddle_point.block_options(prefix) if saddle else {}
    try:
        with callback_errors(), default_options(prefix, built_in):
            snes.setFromOptions()
            if saddle and ksp.getPC().getType() == PETSc.PC.Type.FIELDSPLIT:
                ksp.getPC().setUp()  # the blocks read their options now, and only now
            if not problem.is_assembled:
                _check_inverse_of_sum(ksp)
            if region:
                context.trust_ksp = trust_region_solver(
                    problem.operator, problem.P, prefix, context.linear_choice.direct
                )
    except (PETSc.Error, ImportError) as error:  # an option may name a class of Python
        raise BadInput(f"PETSc rejects an option under -{prefix}: {cause_of(error)}") from None
    parts = (saddle.schur_approximation, *saddle.fields) if saddle else ()
    objects = [problem.x, problem.P, *parts]
    record_solver(problem, snes, *objects)
    return snes


def _check_inverse_of_sum(ksp: PETSc.KSP) -> None:
    """Raise BadInput for ``preonly`` with a preconditioner that lacks the matrices of rank one."""
    if ksp.getType() == PETSc.KSP.Type.PREONLY and not is_factors_of_sum(ksp.getPC()):
        raise BadInput(
            "ksp_type = preonly: expected an iterative solver, as a load adds matrices of rank one "
            "that the preconditioner does not have; -snes_linear_solver direct inverts the sum"
        )


def destroy(snes: PETSc.SNES) -> None:
    """Destroy a SNES of `create` with its linear solvers. Collective."""
    context = snes.getPythonContext()
    for owned in (context.trust_ksp, context.full_ksp, context.asymmetric):
        if owned is not None:
            owned.destroy()
    snes.destroy()


def default_globalization(problem: SolvableProblem) -> str:
    """Return the default globalization of a problem from `DEFAULT_GLOBALIZATIONS`."""
    if problem.saddle_point:
        return DEFAULT_GLOBALIZATIONS["saddle-point problem"]
    kind = "minimisation problem" if problem.has_energy else "forces without an energy"
    return DEFAULT_GLOBALIZATIONS[kind]


def linear_solver_name(snes: PETSc.SNES) -> str:
    """Return PETSc's names of the linear solver and the preconditioner, such as "cg+jacobi".

    The result is "cg+ssor" for `EisenstatCG`. As preconditioners, `BlockTriangular` is named
    "block_triangular" and `FactorsOfSum` "cholesky".
    """
    ksp = snes.getKSP()
    if ksp.getType() == PETSc.KSP.Type.PYTHON:
        return "cg+ssor"
    kind = ksp.getPC().getType()
    if kind == PETSc.PC.Type.PYTHON:
        kind = "cholesky" if is_factors_of_sum(ksp.getPC()) else "block_triangular"
    return f"{ksp.getType()}+{kind}"


def _configure_linear_solver(ksp: PETSc.KSP, problem: SolvableProblem, prefix: str) -> LinearChoice:
    """Configure ``ksp`` as the linear solver before its options are read; return the choice."""
    database = PETSc.Options(prefix)
    named = database.hasName("ksp_type") or database.hasName("pc_type")
    ksp.setTolerances(rtol=_LINEAR_RTOL, atol=0.0, max_it=_LINEAR_MAX_IT)
    wanted = str(database.getString("snes_linear_solver", CHOICES[0]))
    choice = LinearChoice(False) if named else choose_linear_solver(problem, wanted)
    dimension = problem.regime.dimension
    coordinates = problem.coordinates[:, :dimension]
    if choice.direct and not problem.is_assembled:
        set_direct_solver_of_sum(ksp)
    elif choice.direct:
        small = dimension == 2 and problem.comm.size == 1 and problem.x.getSize() <= MAX_SMALL
        set_direct_solver(ksp, small and not problem.saddle_point)
        if problem.pressure_level_is_free:
            expect_singular_matrix(ksp)
    elif problem.saddle_point:
        saddle_point.configure(ksp, problem.P, problem.saddle_point, coordinates, prefix)
    elif not problem.is_assembled:
        # EisenstatCG needs an assembled matrix. A preconditioner of its sparse part leaves one
        # large eigenvalue for each matrix of rank one, which costs conjugate gradients one step.
        ksp.getPC().setType(PETSc.PC.Type.SOR)
        ksp.setType(PETSc.KSP.Type.CG)
    elif not named:
        problem.store_half()
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(EisenstatCG(coordinates))
        ksp.getPC().setType(PETSc.PC.Type.NONE)
    else:
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.getPC().setType(PETSc.PC.Type.JACOBI)
    return choice
