"""Projected Newton for a displacement in a dolfinx program."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

from fem_snh import _dolfinx, solver
from fem_snh._petsc import default_options
from fem_snh.errors import NotSettled, bad_value, choose
from fem_snh.fem.dolfinx_problem import create_dolfinx_problem
from fem_snh.fem.problem import Problem
from fem_snh.kernels.pointwise import Material

#: First guesses when boundary values have changed: see `fem_snh.solver.Predictor`.
_PREDICTORS = ("tangent", "none")


class NonlinearProblem:
    """Find the displacement that minimises the energy of materials and UFL terms. Collective.

    Names and arguments are those of :class:`dolfinx.fem.petsc.NonlinearProblem` (0.10 and later),
    where they mean the same. The materials are assembled by compiled loops with the closed-form
    filter of their Hessian, the terms by dolfinx (their Hessian: `fem_snh.fem.terms.UFLTerm`). The
    solver is that of scenes, a PETSc SNES.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m]: 3 components, continuous Lagrange of degree 1 or 2, on tetrahedra or
        hexahedra. Its values are the initial guess, and become the solution.
    materials : mapping of Material to ufl.Measure
        ``{m1: dx(1), m2: dx(2)}``: the cells that each material fills, by meshtags, or ``{m: dx}``.
        The measures' ``quadrature_degree`` replaces that of the element; other quadrature rules
        are refused. May be empty.
    bcs : sequence of dolfinx DirichletBC, optional
        Dirichlet conditions on the displacement's space or on its components.
    terms : sequence of ufl.Form or SelfContact, optional
        Energies [J] (rank 0) and residuals [N] (rank 1, as for dolfinx) of ``u``, over cells and
        exterior facets. An energy is better than its residual, as it can be minimised. The terms of
        loads are those of an energy, too: -f . u dx for a force f per volume. With a
        `fem_snh.fem.self_contact.choice.SelfContact` the surface of the mesh touches itself.
    petsc_options_prefix : str, optional
        Prefix of the solver's options in PETSc's database.
    petsc_options : mapping, optional
        Options without the prefix, such as ``{"snes_monitor": None}``; those that the database has
        already, as from the command line, come first.
    hessian : {"adaptive", "exact", "clamp", "abs"}, optional
        See `fem_snh.solver.SearchDirection`.
    globalization : {"trust_region", "linesearch"}, optional
        See `fem_snh.solver.create`.
    element : str, optional
        An element with another treatment of the volume term, such as "Q1P0", or with an unknown
        pressure, such as "P2P1": one of `fem_snh.fem.elements.ELEMENTS`. It must have the cell and
        the degree of ``u``. Default: the volume term at every quadrature point.
    predictor : {"tangent", "none"}, optional
        First guess when boundary values have changed: the linearised response to the change, or
        the values alone.

    Attributes
    ----------
    u : dolfinx Function
        The displacement.
    p : dolfinx Function or None
        The pressure [Pa] of an element that has one.
    solver : PETSc.SNES
        The solver; its `ProjectedNewton` has the history of iterations.
    reason : str
        Why the last solve ended: PETSc's name, followed by the cause of a failure, such as
        "DIVERGED_LINEAR_SOLVE: DIVERGED_INDEFINITE_PC"; empty before the first one.
    x : PETSc.Vec
        The unknowns. Without a pressure it is the vector of ``u``, and shares its memory.
    b : PETSc.Vec
        The residual [N].
    A : PETSc.Mat
        The Hessian [N/m].

    Raises
    ------
    BadInput
        On every rank, for input that does not fit together, and for a bad value of an option.

    Notes
    -----
    Functions, constants and boundary values may change between calls of `solve`.

    Examples
    --------
    >>> m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.49)
    >>> problem = fem_snh.NonlinearProblem(u, {m: ufl.dx}, bcs=bcs)
    >>> problem.solve()
    >>> assert problem.solver.getConvergedReason() > 0, problem.reason
    """

    def __init__(
        self,
        u: Any,
        materials: Mapping[Material, Any],
        *,
        bcs: Sequence[Any] | None = None,
        terms: Sequence[Any] = (),
        petsc_options_prefix: str = solver.PREFIX,
        petsc_options: Mapping[str, Any] | None = None,
        hessian: str | None = None,
        globalization: str | None = None,
        element: str | None = None,
        predictor: str = _PREDICTORS[0],
    ) -> None:
        choose("predictor", predictor, _PREDICTORS)
        _check_options(petsc_options_prefix, petsc_options)
        self._problem = self._create(u, materials, bcs, terms, element)
        self._prefix, self._options = petsc_options_prefix, dict(petsc_options or {})
        self.u, self.x, self.A, self.reason = u, self._problem.x, self._problem.A, ""
        with self._petsc_options():
            self.solver = solver.create(self._problem, hessian, globalization, petsc_options_prefix)
        self._predictor = solver.Predictor(self._problem, self.solver, predictor)
        self.b = self.solver.getFunction()[0]
        self._pressure = self._problem.saddle_point
        self.p: Any = self._pressure and _dolfinx.function(self._pressure.Q, "pressure")

    def _create(self, *arguments: Any) -> Problem:
        """Return the problem, from the arguments of `create_dolfinx_problem`."""
        return create_dolfinx_problem(*arguments)

    def solve(self) -> Any:
        """Solve with the present boundary values, constants and functions. Collective.

        Returns
        -------
        dolfinx Function
            The displacement ``u``, ghosts included; the last iterate if the solver diverged.

        Raises
        ------
        petsc4py.PETSc.Error
            If the solver diverged and ``snes_error_if_not_converged`` is set. Otherwise
            ``solver.getConvergedReason()`` is negative, and `reason` says why.
        """
        problem = self._problem
        self._read_displacement()
        problem.history.begin_step(problem.split(self.x)[0])
        with self._petsc_options(), solver.callback_errors():
            if self._solve_until_settled(self._guess).converged:
                problem.history.end_step(problem.split(self.x)[0])
        self._write_solution()
        return self.u

    def _guess(self) -> None:
        """Set the unknowns to the first guess. Collective."""
        if self._boundary_values_changed():
            self._predictor.predict(1.0)
        else:
            self._problem.set_load(1.0)

    def _solve_until_settled(self, guess: Callable[[], None]) -> solver.Outcome:
        """Solve from a guess, again while a term has new lagged quantities. Collective.

        Friction and pairs of self-contact that do not settle, and boundary values with which the
        surface would intersect itself (`ipc`), have the converged reason DIVERGED_INNER.
        """
        outcome = solver.Outcome()
        try:
            guess()
            solver.solve_until_settled(self._problem, self.solver, outcome)
        except NotSettled as error:
            outcome.fail_inner(error)
            self.solver.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_INNER)
        return self._end(outcome)

    def _end(self, outcome: solver.Outcome) -> solver.Outcome:
        """Set the attribute `reason`, and the SNES's converged reason if only it converged."""
        self.reason = outcome.reason
        if not outcome.converged and self.solver.getConvergedReason() > 0:
            self.solver.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_INNER)
        return outcome

    def _read_displacement(self) -> None:
        """Set the unknowns to the values of ``u``."""
        own = self.x.array[: 3 * len(self._problem.coordinates)]
        own[:] = self.u.x.array[: len(own)]

    def _write_solution(self) -> None:
        """Set ``u`` and ``p`` to the unknowns, ghosts included. Collective."""
        self._problem.split(self.x)
        if self._pressure is not None:
            self.p.x.array[:] = self._pressure.pressure()

    def _boundary_values_changed(self) -> bool:
        """Whether the boundary values differ from those of ``x``. Collective."""
        prescribed = self.x.copy()
        self._problem.prescribe(prescribed)
        return not bool(prescribed.equal(self.x))

    @contextmanager
    def _petsc_options(self) -> Iterator[None]:
        """The options in PETSc's database: parts of the solver are set up when it solves."""
        with default_options(self._prefix, self._options):
            yield


def _check_options(prefix: Any, options: Any) -> None:
    """Raise BadInput unless the options are a mapping and the prefix is a text."""
    if not isinstance(prefix, str):
        raise bad_value("petsc_options_prefix", prefix, "a text, e.g. 'press_'")
    if options is not None and not isinstance(options, Mapping):
        raise bad_value("petsc_options", options, "a mapping of options without prefix to values")
    for name in options or {}:
        if not isinstance(name, str) or not name.strip("-"):
            raise bad_value("petsc_options", name, "the name of a PETSc option, e.g. 'ksp_rtol'")
