r"""Energies and forces given as UFL forms.

dolfinx assembles energy and residual. The Hessian is assembled from FFCx's element matrices. If a
filter is chosen, it changes the negative eigenvalues of each cell's or facet's matrix, so that the
assembled sum is positive semidefinite, as with the closed-form filter of the materials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isnan
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.algorithms.check_arities import check_form_arity
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.unknowns import copy_to_function
from fem_snh.choices import FILTERS
from fem_snh.errors import BadInput, bad_value, choose
from fem_snh.kernels.cell_matrices import FormCells, Integral
from fem_snh.references import describe_error
from fem_snh.terms.term import Term

#: Relative asymmetry of element matrices up to which a residual has an energy: far above rounding.
_SYMMETRIC = 1e-10
#: What an entry of a program's list ``terms`` may be, for messages.
TERM = (
    "a UFL form, an energy (rank 0) or a residual (rank 1); a feature such as fem_snh.Pressure; or "
    "a term, derived from fem_snh.Term"
)
#: Integrals that have one element matrix per cell or facet.
_KINDS = ("cell", "exterior_facet")
#: Characters that a message shows of an error of FFCx: two lines of a terminal. An error of the C
#: compiler contains its whole command.
_SHOWN = 160


class UFLTerm(Term):
    r"""A term given by a UFL energy or residual of the displacement. Collective.

    ====================  ==========================================================================
    energy, rank 0        E(u) [J]; residual and Hessian are its derivatives
    residual, rank 1      R(u; v) [N], linear in the test function v. If R is constant in u (a dead
                          load), or linear in u with a symmetric derivative, the energy is
                          :math:`\int_0^1 R(t u; u) \, \mathrm{d}t`. Otherwise ``has_energy`` is
                          False, the exact Hessian is dR/du, and a filtered Hessian is the filtered
                          symmetric part of dR/du.
    ====================  ==========================================================================

    Parameters
    ----------
    form : ufl.Form
        Integrals over cells (dx) and exterior facets (ds), also of subdomains.
    u : dolfinx Function
        The displacement in ``form``, of a Lagrange space.
    name : str, optional
        The term's name in run.json.
    depends_on_load : bool, optional
        Whether the program sets the form's constants and functions for a load.

    Attributes
    ----------
    has_energy : bool
        Whether the term's forces are the gradient of an energy.
    symmetric : bool
        Whether `add_hessian` adds the symmetric part of dR/du; it is dR/du itself if there is an
        energy. Without an energy `fem_snh.problem.problem.Problem` sets this attribute.

    Raises
    ------
    BadInput
        On every rank, for a form of rank 2 or more, an energy that does not contain the
        displacement, integrals over other entities, or a form that UFL or FFCx cannot compile.

    Notes
    -----
    Constants and functions in the form may change between solves. A dead load is assembled at the
    first evaluation after `set_load`, once per solve.
    """

    stateless = True

    def __init__(self, form: Any, u: Any, name: str = "ufl", depends_on_load: bool = False) -> None:
        check_form(form, u, name)
        if np.issubdtype(PETSc.ScalarType, np.complexfloating):
            raise bad_value("PETSc.ScalarType", "complex", "a PETSc configured with real numbers")
        self.name, self.depends_on_load = name, depends_on_load
        self._comm = u.function_space.mesh.comm
        V = u.function_space
        # A copy: vectors beside the solution's are evaluated, too.
        self._u = _dolfinx.function(V, "displacement")
        v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
        with _compiling(name):
            form = ufl.replace(expand_derivatives(form), {u: self._u})
            energy = None if form.arguments() else form
            residual = _derivative(form, self._u, v) if energy is not None else form
            hessian = _derivative(residual, self._u, w)
        self._force = _dolfinx.create_vector(V) if hessian.empty() else None
        self._is_current = False
        self._hessian = None if hessian.empty() else compile_form(hessian, name)
        self._cells = None if self._hessian is None else self._form_cells()
        if energy is None and self._cells and self._is_linear_and_symmetric(hessian):
            # u . R(u) has the quadratic part twice and the linear part once.
            energy = _at_u(residual, self._u) - 0.5 * _at_u(hessian, self._u)
        self.has_energy = self.symmetric = energy is not None or self._hessian is None
        self._residual = compile_form(residual, name)
        self._energy = None if energy is None or self._force else compile_form(energy, name)

    @property
    def has_hessian(self) -> bool:
        """Whether the forces depend on the displacement."""
        return self._cells is not None

    @property
    def rounds_identity(self) -> bool:
        """True, as forms evaluate I + grad u, unless the term is a dead load."""
        return self.has_hessian

    def set_load(self, load: float) -> None:
        """Let the next evaluation assemble a dead load again, with the constants of that time."""
        self._is_current = False

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy [J]; +inf if the integral is NaN. Collective.

        The energy of a dead load is zero at u = 0.

        Raises
        ------
        BadInput
            If the term is a force without an energy.
        """
        if self._force is not None:
            return float(self._current_force().dot(u))
        if self._energy is None:
            raise BadInput(f"the term '{self.name}' has no energy, only a residual")
        copy_to_function(u, self._u)
        energy = _dolfinx.assemble_scalar(self._energy)
        return float("inf") if isnan(energy) else energy

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to ``r_u``; of a dead load, to owned entries alone. Collective."""
        if self._force is not None:
            r_u.array[:] += self._current_force().array_r
        else:
            copy_to_function(u, self._u)
            _dolfinx.add_vector(r_u, self._residual)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the Hessian [N/m], filtered by element matrices: see `Term.add_hessian`."""
        filtered = 0
        for cells, matrices, count in self.element_matrices(u, filter, self.symmetric):
            target.add_matrices(cells, matrices)
            filtered += count
        return filtered

    def element_matrices(
        self, u: PETSc.Vec, filter: str, symmetric: bool
    ) -> Iterator[tuple[Any, Any, int]]:
        """Yield the element matrices [N/m] of dR/du: see `FormCells.matrices`."""
        choose("filter", filter, FILTERS)
        if self._cells is None:
            return
        copy_to_function(u, self._u)
        for integral in self._integrals():
            yield from self._cells.matrices(integral, filter, symmetric)

    def _current_force(self) -> PETSc.Vec:
        """Return dE/du [N] of a dead load, a vector that is assembled once after `set_load`."""
        if not self._is_current:
            _dolfinx.assemble_vector(self._force, self._residual)
            self._is_current = True
        return self._force

    def _form_cells(self) -> FormCells:
        V = self._u.function_space
        return FormCells(
            self._comm,
            _dolfinx.kernel_arguments(self._hessian),
            _dolfinx.node_dofs(V).shape[1],
            _dolfinx.num_components(V),
            _dolfinx.geometry_dofs(V.mesh),
            _dolfinx.geometry_x(V.mesh),
        )

    def _integrals(self) -> list[Integral]:
        """Return the Hessian's integrals with the present values of coefficients and constants."""
        constants, coefficients = _dolfinx.pack(self._hessian)
        return [
            Integral(i.kernel, i.entities, coefficients[i.key], constants)
            for i in _dolfinx.integrals(self._hessian)
        ]

    def _is_linear_and_symmetric(self, hessian: Any) -> bool:
        """Return whether a residual is linear in u with a symmetric ``hessian``. Collective."""
        if self._cells is None or self._u in hessian.coefficients():
            return False
        worst = max((self._cells.asymmetry(i) for i in self._integrals()), default=0.0)
        return bool(self._comm.allreduce(worst, op=MPI.MAX) < _SYMMETRIC)


def check_form(form: Any, u: Any, name: str) -> None:
    """Raise BadInput, with key ``name``, unless ``form`` is an energy or a residual of ``u``."""
    if not isinstance(form, ufl.Form):
        raise bad_value(name, form, TERM)
    V, arguments = u.function_space, form.arguments()
    spaces = [argument.ufl_function_space() for argument in arguments]
    if len(arguments) > 1:
        accepted = "an energy (rank 0) or a residual (rank 1); its derivatives are taken here"
        raise bad_value(name, f"a form of rank {len(arguments)}", accepted)
    if [*form.ufl_domains()] != [V.mesh.ufl_domain()]:
        raise bad_value(name, "a form on another mesh", "the mesh of the displacement")
    if spaces not in ([], [V]):
        raise bad_value(name, str(spaces[0]), "a test function of the displacement's own space")
    if not arguments and u not in form.coefficients():
        raise bad_value(name, "a form without the displacement", f"an energy of {u.name}")
    kinds = sorted({integral.integral_type() for integral in form.integrals()} - set(_KINDS))
    if kinds:
        raise bad_value(name, kinds[0], "integrals over cells (dx) or exterior facets (ds)")


def compile_form(form: Any, name: str) -> Any:
    """Return a compiled form; raise BadInput, with key ``name``, if that fails. Collective."""
    with _compiling(name):
        # On every rank: dolfinx lets this error, which is no Exception, leave the first one alone.
        check_form_arity(remove_complex_nodes(form), form.arguments())
        return _dolfinx.form(form)


@contextmanager
def _compiling(name: str) -> Iterator[None]:
    """Turn errors of UFL, FFCx and its C compiler into BadInput with key ``name``."""
    try:
        yield
    except (MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # of many classes; UFL's ArityMismatch is no Exception
        text = describe_error(error)
        text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
        message = f"{name} = a form: expected one that UFL and FFCx compile: {text}"
        raise BadInput(message) from error


def _derivative(form: Any, u: Any, direction: Any) -> Any:
    return expand_derivatives(ufl.derivative(form, u, direction))


def _at_u(form: Any, u: Any) -> Any:
    """Return the form with its arguments replaced by ``u``."""
    return ufl.replace(form, dict.fromkeys(form.arguments(), u))


class UFLTerms(Term):
    """A sum of energies or residuals, each times an amplitude that is a function of the load.

    Each summand is a `UFLTerm`, because UFL accepts one set of marked facets per form.

    Parameters
    ----------
    name : str
        The term's name in run.json.
    u : dolfinx Function
        The displacement in the forms.
    """

    has_energy = stateless = True

    def __init__(self, name: str, u: _dolfinx.Function) -> None:
        self.name, self._u = name, u
        self._terms: list[UFLTerm] = []
        self._factors: list[tuple[Any, Callable[[float], float]]] = []

    def add(self, form: Any, amplitude: Callable[[float], float] | None = float) -> None:
        """Add a form times an amplitude, by default the load itself; None means 1. Collective."""
        at_rest = 1.0 if amplitude is None else amplitude(0.0)
        factor = _dolfinx.constant(self._u.function_space.mesh, at_rest)
        self._terms.append(UFLTerm(factor * form, self._u, self.name))
        if amplitude is not None:
            self._factors.append((factor, amplitude))
            self.depends_on_load = True

    def add_load(self, density: Any, measure: Any, amplitude: Callable[[float], float]) -> None:
        """Add the dead load of a force density over a UFL measure. Collective."""
        self.add(-ufl.inner(density, self._u) * measure, amplitude)

    def set_load(self, load: float) -> None:
        """Set the amplitudes at a load; the next evaluation assembles dead loads again."""
        for factor, amplitude in self._factors:
            factor.value = np.array(amplitude(load))
        for term in self._terms:
            term.set_load(load)

    @property
    def has_hessian(self) -> bool:
        """Whether the forces depend on the displacement."""
        return any(term.has_hessian for term in self._terms)

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the sum of the energies [J]. Collective."""
        return sum(term.energy(u, p) for term in self._terms)

    @property
    def symmetric(self) -> bool:
        """Whether all summands add the symmetric part of dR/du: see `UFLTerm`. Settable."""
        return all(term.symmetric for term in self._terms)

    @symmetric.setter
    def symmetric(self, value: bool) -> None:
        for term in self._terms:
            term.symmetric = value

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to ``r_u``, as `UFLTerm.add_residual` does. Collective."""
        for term in self._terms:
            term.add_residual(u, p, r_u, r_p)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the Hessian [N/m], filtered by element matrices: see `Term.add_hessian`."""
        return sum(term.add_hessian(u, p, filter, target) for term in self._terms)
