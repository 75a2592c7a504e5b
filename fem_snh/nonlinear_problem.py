"""Equilibria of a body in a dolfinx program, by projected Newton: `NonlinearProblem`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

from fem_snh import _dolfinx, solver
from fem_snh.errors import ResultNote, check_whole, choose
from fem_snh.kernels.material import Material
from fem_snh.problem.conditions import LoadFunction
from fem_snh.problem.definition import check_lists, define
from fem_snh.problem.free_motions import SupportsCheck
from fem_snh.problem.state_notes import program_notes
from fem_snh.program_results import estimate_error, modes, reaction, reaction_moment
from fem_snh.records.run_record import Note
from fem_snh.solver.options import GivenOptions
from fem_snh.steps.cell_pressures import program_pressures
from fem_snh.steps.jump_detection import jump_notes, start_notes
from fem_snh.steps.program_replay import SolverChoice, follow_load, program_path
from fem_snh.steps.stepping import Stepper, StepSolver, boundary_values_changed

if TYPE_CHECKING:
    from fem_snh.accuracy.path_errors import Path
    from fem_snh.geometry.motions import Bone
    from fem_snh.mesh.mesh import Mesh
    from fem_snh.tables.amplitudes import Amplitudes

#: The predictors that a program may choose, and for each the predictor of the second and later
#: steps of `NonlinearProblem.steps`: kinds of `fem_snh.solver.Predictor`.
PREDICTORS = {"tangent": "extrapolate", "none": "none"}
#: Largest number of load steps.
_MAX_STEPS = 1_000_000


class NonlinearProblem:
    """Find the displacement that minimises the energy of materials and UFL terms. Collective.

    Arguments and attributes that :class:`dolfinx.fem.petsc.NonlinearProblem` (0.10 and later) also
    has mean the same here. Compiled loops assemble the materials and filter their Hessian in closed
    form; dolfinx assembles UFL terms (for their Hessian see `UFLTerm`). The solver is the PETSc
    SNES that solves scenes.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m]: 3 components, continuous Lagrange of degree 1 or 2, on tetrahedra or
        hexahedra; for two dimensions see ``kinematics``. Its values are the initial guess, and
        become the solution.
    materials : mapping of Material to ufl.Measure
        The cells that each material fills, by meshtags: ``{m1: dx(1), m2: dx(2)}``, or ``{m: dx}``
        for all cells. A ``quadrature_degree`` of the measures, the same for all, replaces the
        element's; quadrature rules other than the default raise BadInput. May be empty.
    bcs : sequence of dolfinx DirichletBC or Symmetry, optional
        Dirichlet conditions on the displacement's space or on its components, and planes of
        symmetry: `fem_snh.Symmetry`.
    terms : sequence of ufl.Form, feature or Term, optional
        Energies [J] (rank 0) and residuals [N] (rank 1, as for dolfinx) of ``u``, over cells and
        exterior facets. Prefer an energy to its residual: it can be minimised. A load is written as
        its potential: -f . u dx for a force f per volume. Features are the objects that are tables
        in a scene: `fem_snh.Traction`, `fem_snh.Gravity`, `fem_snh.Pressure`, `fem_snh.Spring`,
        `fem_snh.Cavity`, `fem_snh.SelfContact`; their values may be UFL expressions without ``u``.
        `solve` applies the loads of features in full, `steps` in proportion to the load. Any other
        object must have the methods of `fem_snh.Term`.
    petsc_options_prefix : str, optional
        Prefix of the solver's options in PETSc's database.
    petsc_options : mapping, optional
        Options without the prefix, such as ``{"snes_monitor": None}``. An option that PETSc's
        database already has, for example from the command line, takes precedence.
    hessian : {"adaptive", "exact", "clamp", "abs"}, optional
        See `fem_snh.solver.search_direction.SearchDirection`.
    globalization : {"trust_region", "linesearch"}, optional
        See `fem_snh.solver.create`.
    element : str, optional
        The name of an element that treats the volume term differently, such as "Q1P0", or has an
        unknown pressure, such as "P2P1": one of `fem_snh.assembly.elements.ELEMENTS`, with the cell
        and the degree of ``u``. Default: the volume term at every quadrature point.
    densities : mapping of Material to float, optional
        Mass per reference volume [kg/m^3] of each material, for its weight and its vibrations.
    predictor : {"tangent", "none"}, optional
        First guess when boundary values have changed: the linearised response to the change
        ("tangent"), or the new boundary values beside the old displacement ("none"). From the
        second step of `steps` on, "tangent" extrapolates the displacement of the last step.
    static_condensation : bool, optional
        Whether the cell pressures of "Q1P0" and "P2P0" are eliminated from the start. Otherwise a
        mixed problem with cell pressures as unknowns is solved first. Default: False from
        nu = 0.499 on, where the condensed problem takes many iterations, unless a term has a state
        of its own or the condensed problem's solver was chosen.
    kinematics : {"plane_strain", "plane_stress", "axisymmetric", "axisymmetric_torsion"}, optional
        Required on a mesh of two dimensions (triangles or quadrilaterals), where ``u`` has 2
        components, (u_x, u_y) or (u_r, u_z), or with torsion 3, (u_r, u_z, u_theta), in the basis
        of the reference position. Coordinates are (x, y) or (r, z), r >= 0. On the axis r = 0, u_r
        and u_theta are zero. In a plane, energies are per thickness [J/m] and forces [N/m]; on a
        body of revolution both are of the whole turn, so forms in ``terms`` need the factor 2 pi r.
    volume : callable, optional
        A volume energy U(J) [Pa] in UFL, such as ``lambda J: k/2 * (J - 1)**2``, integrated over
        all cells beside the energies in ``terms``. "Q1P0" and "P2P0" evaluate it at the mean J of
        each cell; they do not change forms in ``terms``. Keep (J - 1)**2 times a few times the
        shear modulus in ``terms``: it limits the variation of J within a cell.
    mesh : Mesh, optional
        The mesh of ``u`` with physical groups, as `Scene.build` returns it:
        ``materials``, ``bcs`` and ``terms`` may then name groups in place of measures.
    bones : sequence of Bone, optional
        Bones, which prescribe the displacement of the nodes in them
        (`fem_snh.geometry.motions.Bone`).
    amplitudes : Amplitudes, optional
        The tables that ``bcs`` and ``terms`` may name.
    quadrature : int, optional
        The quadrature degree if ``materials`` has no measures.

    Attributes
    ----------
    u : dolfinx Function
        The displacement.
    p : dolfinx Function or None
        The pressure [Pa] of an element with an unknown pressure, positive in tension.
    solver : PETSc.SNES
        The solver; its Python context, a `ProjectedNewton`, has the history of iterations.
    newton, linear : int
        Newton and linear iterations of the last solve or step, including the predictor and the
        mixed problem with unknown cell pressures.
    reason : str
        Why the last solve ended: PETSc's name, followed by the cause of a failure, such as
        "DIVERGED_LINEAR_SOLVE: DIVERGED_INDEFINITE_PC"; empty before the first solve.
    row : dict
        The row of the last solve or step, as `steps` yields it: energy, volume, forces of contact
        and rigid parts, states of cavities, ...; empty before the first solve.
    x : PETSc.Vec
        The unknowns. Without an unknown pressure it shares the memory of ``u``.
    notes : list of Note
        Reservations about the last state although it converged: an element that locks, inverted
        points, a jump within a step (`fem_snh.records.run_record`). The first note of each kind
        is also a warning, `fem_snh.errors.ResultNote`.
    b : PETSc.Vec
        The residual [N], zero at constrained dofs.
    A : PETSc.Mat
        The Hessian [N/m] that was assembled last, possibly filtered: an AIJ matrix, a copy if the
        solver stores one half, which from the first access on is renewed in every assembly.

    Raises
    ------
    BadInput
        On every rank, for arguments that contradict each other, and for a bad value of an option.
        `solve` and `steps` raise it if loads act along a rigid motion that nothing constrains.

    Notes
    -----
    Functions, constants and boundary values may change between calls of `solve`. The lists ``bcs``
    and ``terms`` may not change.

    Examples
    --------
    >>> m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.49)
    >>> problem = fem_snh.NonlinearProblem(u, {m: ufl.dx}, bcs=bcs)
    >>> problem.solve()
    >>> assert problem.solver.getConvergedReason() > 0, problem.reason
    """

    estimate_error, vibration_modes = estimate_error, modes
    reaction_force, reaction_moment = reaction, reaction_moment
    _path: Path | None = None

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
        densities: Mapping[Material, float] | None = None,
        predictor: str = "tangent",
        static_condensation: bool | None = None,
        kinematics: str | None = None,
        volume: Callable[[Any], Any] | None = None,
        mesh: Mesh | None = None,
        bones: Sequence[Bone] = (),
        amplitudes: Amplitudes | None = None,
        quadrature: int | None = None,
    ) -> None:
        choose("predictor", predictor, PREDICTORS)
        options = GivenOptions(petsc_options_prefix, petsc_options)
        self._load = LoadFunction()
        given = u, materials, bcs, terms, element, densities, volume, kinematics
        groups = mesh, bones, amplitudes, quadrature
        self._problem = define(*given, *groups, **self._in_time()).problem()
        self._check_lists = partial(check_lists, self._problem, bcs, terms)
        self._prefix, self._given = petsc_options_prefix, options
        self.u, self.x, self.reason = u, self._problem.x, ""
        self.newton, self.linear, self.row = 0, 0, dict[str, Any]()
        with self._given.active():
            self.solver = solver.create(self._problem, hessian, globalization, petsc_options_prefix)
            choices = {"hessian": hessian, "globalization": globalization}
            pressures = program_pressures(static_condensation, self._problem, choices, self._prefix)
        self._steps = {
            name: StepSolver(self._problem, self.solver, name, None, pressures)
            for name in dict.fromkeys((predictor, PREDICTORS[predictor]))
        }
        chosen = self._prefix, options.values, hessian, globalization, PREDICTORS[predictor]
        self._path_of = partial(program_path, self._problem, self._load, SolverChoice(*chosen))
        self._predictor, self.b = predictor, self.solver.getFunction()[0]
        self._is_new, self._warned, self.notes = True, set[str](), list[Note]()
        self._load_notes = [Note("load", term.note) for term in self._problem.terms if term.note]
        self._supports, self._pressure = SupportsCheck(self._problem), self._problem.saddle_point
        self.p: Any = self._pressure and _dolfinx.function(self._pressure.Q, "pressure")

    def _in_time(self) -> dict[str, Any]:
        """Return the keyword arguments of `define` that differ between statics and motion."""
        return {"on_load": self._load}

    @property
    def A(self) -> PETSc.Mat:
        """The Hessian, see the class. The first access makes the matrix. Collective."""
        return self._problem.A

    def solve(self) -> Any:
        """Solve for the present boundary values, constants and functions. Collective.

        Returns
        -------
        dolfinx Function
            The displacement ``u`` with updated ghosts; the last iterate if the solver diverged.

        Raises
        ------
        petsc4py.PETSc.Error
            If the solver diverged and ``snes_error_if_not_converged`` is set. Otherwise
            ``solver.getConvergedReason()`` is negative, and `reason` says why.
        """
        self._check_lists()
        self._read_displacement()
        self._path, self._is_new = None, False
        self._supports.check()
        changed = boundary_values_changed(self._problem)
        with self._given.active():
            stepper = Stepper(self._steps[self._predictor], 1, find_jumps=False)
            self._end(stepper.attempt(self._problem.load, 1.0, predict=changed, restore=False))
        self._write_solution()
        return self.u

    def steps(
        self, number: int, set_load: Callable[[float], None] | None = None
    ) -> Iterator[dict[str, Any]]:
        """Solve by load steps from the present displacement. Collective.

        A step that fails is rolled back and halved, down to 1/64 of the nominal step, as in a run
        of a scene. The generator solves a step when its next row is requested.

        Parameters
        ----------
        number : int
            Number of equal steps in which the load parameter goes from 0 to 1.
        set_load : callable, optional
            ``set_load(load)`` sets constants, functions and boundary values for a load from 0 to 1.
            Without it the boundary values change linearly with the load from the present values of
            ``u`` to the values of ``bcs``.

        Yields
        ------
        dict
            The row of an attempted step, as in run.json: ``load``, ``converged``, ``reason``,
            ``newton``, ``linear``, ``energy``, ``min_J``, ... After each row, ``u`` is the solution
            at the last load that converged. If the load does not reach 1, the last row has
            ``converged`` False.

        Examples
        --------
        >>> for step in problem.steps(12):
        ...     print(step["load"], step["newton"])
        >>> assert step["converged"], problem.reason
        """
        stepper = self._stepper(number)
        self._read_displacement()
        following = partial(follow_load, load=self._load, set_load=set_load)
        self._path = self._path_of(stepper, following) if self._is_new else None
        self._is_new = False
        with following(self._problem):
            self._problem.set_load(0.0)
            self._problem.prescribe(self.x)
            # An earlier path's equilibria say nothing about the start of this one.
            stepper.solver.predictor.before = None
            self._supports.check()
            yield from self._rows(stepper, [] if set_load else start_notes(self._problem))

    def _stepper(self, number: int) -> Stepper:
        """Return the iterator over ``number`` equal steps of the load from 0 to 1."""
        check_whole("number", number, 1, _MAX_STEPS)
        self._check_lists()
        return Stepper(self._steps[PREDICTORS[self._predictor]], number)

    def _rows(self, stepper: Stepper, notes: Sequence[Note] = ()) -> Iterator[dict[str, Any]]:
        """Solve up to load 1: yield each step's row, and set `notes` to ``notes`` and its own."""
        rows = iter(stepper)
        for attempted in count():
            with self._given.active():
                row = next(rows, None)
            if row is None:
                return
            self._end(row, [*notes, *jump_notes(stepper.jump, attempted)])
            self._write_solution()
            yield row

    def negative_eigenvalues(self) -> int:
        """Return how many eigenvalues of the Hessian are negative at the present state. Collective.

        An equilibrium is stable if none is. With an unknown pressure, even a stable equilibrium has
        one negative eigenvalue for each pressure dof: these are subtracted. The exact Hessian is
        assembled and factorised.

        Raises
        ------
        BadInput
            If the body moves in time, or if a term is a residual without an energy.
        Failed
            If the factors do not fit into memory.
        """
        self._read_displacement()
        with self._given.active():
            return solver.EquilibriumStability(self._problem).negative_eigenvalues(self.x)

    def _end(self, row: dict[str, Any], notes: Sequence[Note] = ()) -> None:
        """Set `row`, `reason`, `newton`, `linear` and `notes` after a step. Collective.

        The SNES of a failed step gets DIVERGED_INNER if it converged. Rank 0 warns of new notes.
        """
        self.row, self.reason = row, row["reason"]
        self.newton, self.linear = row["newton"], row["linear"]
        if not row["converged"] and self.solver.getConvergedReason() > 0:
            self.solver.setConvergedReason(PETSc.SNES.ConvergedReason.DIVERGED_INNER)
        negative = row.get("negative_eigenvalues")
        rounding = self.solver.getPythonContext().rounding
        found = program_notes(self._problem, negative, rounding) if row["converged"] else []
        own = [*self._load_notes, *self._supports.notes, *self._given.notes()]
        self.notes = [*own, *notes, *found]
        for note in self.notes:
            if note.kind not in self._warned and self._problem.comm.rank == 0:
                warnings.warn(note.text, ResultNote, stacklevel=3)
            self._warned.add(note.kind)

    def _read_displacement(self) -> None:
        """Copy the owned values of ``u`` to the unknowns `x`."""
        own = self.x.array[: self._problem.owned_displacements]
        own[:] = self.u.x.array[: len(own)]

    def _write_solution(self) -> None:
        """Copy the unknowns `x` to ``u`` and ``p``, and update their ghosts. Collective."""
        self._problem.split(self.x)
        if self._pressure is not None:
            self.p.x.array[:] = self._pressure.pressure()
