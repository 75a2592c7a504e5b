"""Projected Newton for a displacement in a dolfinx program."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

from fem_snh import _dolfinx, solver
from fem_snh.accuracy.state_notes import program_notes
from fem_snh.errors import ResultNote, check_whole, choose
from fem_snh.kernels.material import Material
from fem_snh.problem.conditions import LoadFunction
from fem_snh.problem.definition import check_lists, define
from fem_snh.problem.free_motions import SupportsCheck
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

#: First guesses when boundary values have changed, and those of the steps of `steps`: see
#: `fem_snh.solver.Predictor`.
PREDICTORS = {"tangent": "extrapolate", "none": "none"}
#: Largest number of load steps.
_MAX_STEPS = 1_000_000


class NonlinearProblem:
    """Find the displacement that minimises the energy of materials and UFL terms. Collective.

    Names and arguments are those of :class:`dolfinx.fem.petsc.NonlinearProblem` (0.10 and later),
    where they mean the same. The materials are assembled by compiled loops with the closed-form
    filter of their Hessian, the terms by dolfinx (their Hessian: `UFLTerm`). The
    solver is that of scenes, a PETSc SNES.

    Parameters
    ----------
    u : dolfinx Function
        The displacement [m]: 3 components, continuous Lagrange of degree 1 or 2, on tetrahedra or
        hexahedra; in two dimensions see ``kinematics``. Its values are the initial guess, and
        become the solution.
    materials : mapping of Material to ufl.Measure
        ``{m1: dx(1), m2: dx(2)}``: the cells that each material fills, by meshtags, or ``{m: dx}``.
        The measures' ``quadrature_degree`` replaces that of the element; other quadrature rules
        are refused. May be empty.
    bcs : sequence of dolfinx DirichletBC or Symmetry, optional
        Dirichlet conditions on the displacement's space or on its components, and planes of
        symmetry: `fem_snh.Symmetry`.
    terms : sequence of ufl.Form, feature or Term, optional
        Energies [J] (rank 0) and residuals [N] (rank 1, as for dolfinx) of ``u``, over cells and
        exterior facets. An energy is better than its residual, as it can be minimised. The terms of
        loads are those of an energy, too: -f . u dx for a force f per volume. Features are the
        objects that are tables in a scene: `fem_snh.Traction`, `fem_snh.Gravity`,
        `fem_snh.Pressure`, `fem_snh.Spring`, `fem_snh.Cavity`, `fem_snh.SelfContact`; `solve`
        applies loads as a whole, `steps` in proportion to the load. Their values may be UFL
        expressions without ``u``. Any other object has the methods of `fem_snh.Term`.
    petsc_options_prefix : str, optional
        Prefix of the solver's options in PETSc's database.
    petsc_options : mapping, optional
        Options without the prefix, such as ``{"snes_monitor": None}``; those that the database has
        already, as from the command line, come first.
    hessian : {"adaptive", "exact", "clamp", "abs"}, optional
        See `fem_snh.solver.search_direction.SearchDirection`.
    globalization : {"trust_region", "linesearch"}, optional
        See `fem_snh.solver.create`.
    element : str, optional
        An element with another treatment of the volume term, such as "Q1P0", or with an unknown
        pressure, such as "P2P1": one of `fem_snh.assembly.elements.ELEMENTS`. It must have the cell
        and the degree of ``u``. Default: the volume term at every quadrature point.
    densities : mapping of Material to float, optional
        Mass per reference volume [kg/m^3] of each material, which its weight and vibrations need.
    predictor : {"tangent", "none"}, optional
        First guess when boundary values have changed: the linearised response to the change, or
        the values alone. From the second step of `steps` on, "tangent" continues the step before.
    static_condensation : bool, optional
        Whether the pressures of the cells of "Q1P0" and "P2P0" are eliminated, or unknowns of a
        problem that is solved first. Default: unknowns from nu = 0.499 on, where the condensed
        problem takes many iterations, unless a term has a state of its own or the condensed
        problem's solver was chosen.
    kinematics : {"plane_strain", "plane_stress", "axisymmetric", "axisymmetric_torsion"}, optional
        Of a mesh of two dimensions, with triangles or quadrilaterals. ``u`` then has 2 components,
        (u_x, u_y) or (u_r, u_z); with torsion 3, (u_r, u_z, u_theta), in the basis of the reference
        position. Coordinates are (x, y) or (r, z), r >= 0; u_r and u_theta are zero where r = 0.
        In plane strain energies are per thickness [J/m] and forces [N/m]; on a body of revolution
        they are those of the whole turn: integrals of ``terms`` have the factor 2 pi r.

    volume : callable, optional
        A volume energy U(J) [Pa] of UFL over all cells, such as ``lambda J: k/2 * (J - 1)**2``,
        beside energies in ``terms``: "Q1P0" and "P2P0" treat it as the volume terms of materials,
        by the mean J of each cell. Forms in ``terms`` are not treated by any element; leave a few
        times the shear modulus in them, as (J - 1)**2, against a J that varies within a cell.
    mesh : Mesh, optional
        The mesh of ``u`` with physical groups, as `Scene.build` returns it:
        ``materials``, ``bcs`` and ``terms`` may then name groups in place of measures.
    bones : sequence of Bone, optional
        Bones whose nodes follow them (`fem_snh.geometry.motions.Bone`).
    amplitudes : Amplitudes, optional
        The tables that ``bcs`` and ``terms`` may name.
    quadrature : int, optional
        The quadrature degree, where no measure has one.

    Attributes
    ----------
    u : dolfinx Function
        The displacement.
    p : dolfinx Function or None
        The pressure [Pa] of an element that has one.
    solver : PETSc.SNES
        The solver; its `ProjectedNewton` has the history of iterations.
    newton, linear : int
        Newton and linear iterations of the last solve or step: those of the prediction and of the
        problem with unknown cell pressures included.
    reason : str
        Why the last solve ended: PETSc's name, followed by the cause of a failure, such as
        "DIVERGED_LINEAR_SOLVE: DIVERGED_INDEFINITE_PC"; empty before the first one.
    row : dict
        The row of the last solve or step, as `steps` yields it: energy, volume, forces of contact
        and rigid parts, states of cavities, ...; empty before the first one.
    x : PETSc.Vec
        The unknowns. Without a pressure it is the vector of ``u``, and shares its memory.
    notes : list of Note
        What to know beside "converged" of the last state: an element that locks, points that are
        inverted, a jump within a step (`fem_snh.records.run_record`). The first note of each kind
        is also a warning, `fem_snh.errors.ResultNote`.
    b : PETSc.Vec
        The residual [N].
    A : PETSc.Mat
        The Hessian [N/m].

    Raises
    ------
    BadInput
        On every rank, for input that does not fit together, and for a bad value of an option;
        from `solve` and `steps`, if loads act along a rigid motion that nothing constrains.

    Notes
    -----
    Functions, constants and boundary values may change between calls of `solve`, the lists ``bcs``
    and ``terms`` may not.

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
        self.u, self.x, self.A, self.reason = u, self._problem.x, self._problem.A, ""
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
        """Return what `define` needs of the load or the time."""
        return {"on_load": self._load}

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

        A step that fails is rolled back and halved, down to 1/64 of the nominal one, as in a run of
        a scene. The next step starts when the loop asks for it.

        Parameters
        ----------
        number : int
            Number of equal steps in which the load goes from 0 to 1.
        set_load : callable, optional
            ``set_load(load)`` sets constants, functions and boundary values for a load from 0 to 1.
            Without it the boundary values go from those of ``u`` to those of ``bcs``, in proportion
            to the load.

        Yields
        ------
        dict
            The row of an attempted step, as in run.json: ``load``, ``converged``, ``reason``,
            ``newton``, ``linear``, ``energy``, ``min_J``, ... ``u`` is the solution at that load,
            or at the last that converged. If the load does not reach 1, the last row has
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
        """Return equal steps of the load from 0 to 1."""
        check_whole("number", number, 1, _MAX_STEPS)
        self._check_lists()
        return Stepper(self._steps[PREDICTORS[self._predictor]], number)

    def _rows(self, stepper: Stepper, notes: Sequence[Note] = ()) -> Iterator[dict[str, Any]]:
        """Yield the rows of the steps from the present load to 1, which all have these notes."""
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

        An equilibrium is stable if none is. With a pressure as an unknown, those that it has at a
        stable one are not counted. The exact Hessian is assembled and factorised.

        Raises
        ------
        BadInput
            In time, or if a term is a residual without an energy.
        Failed
            If the factors do not fit into memory.
        """
        self._read_displacement()
        with self._given.active():
            return solver.EquilibriumStability(self._problem).negative_eigenvalues(self.x)

    def _end(self, row: dict[str, Any], notes: Sequence[Note] = ()) -> None:
        """Keep the row of a step, and set the notes; the SNES has its converged reason.

        Warn of new kinds of notes on rank 0. Collective.
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
        """Set the unknowns to the values of ``u``."""
        own = self.x.array[: self._problem.owned_displacements]
        own[:] = self.u.x.array[: len(own)]

    def _write_solution(self) -> None:
        """Set ``u`` and ``p`` to the unknowns, ghosts included. Collective."""
        self._problem.split(self.x)
        if self._pressure is not None:
            self.p.x.array[:] = self._pressure.pressure()
