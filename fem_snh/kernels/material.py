"""Evaluate a material at given deformation gradients, with the kernels of the assembly.

`Material` and `material` are public: ``fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)``.
`svd` and `eigen3` are the kernels' singular value decomposition and eigensolvers, for arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fem_snh import materials
from fem_snh.choices import EIGENSOLVERS, POINT_FILTERS
from fem_snh.errors import BadInput, choose
from fem_snh.kernels import build
from fem_snh.kernels.build import POINTWISE, header
from fem_snh.kernels.compiled import compile_kernel
from fem_snh.materials.numbers import Numbers, numbers_of, store, stored, stored_key
from fem_snh.materials.parameters import check_constants

if TYPE_CHECKING:
    from fem_snh.kernels.reports.report import Report
    from fem_snh.materials.energy import Energy


Array = npt.NDArray[np.float64]


@lru_cache
def _svd_eigen_library() -> tuple[Any, Any]:
    """Return the compiled SVD and eigensolvers."""
    return build.open_library(
        ["svd_eigen_api.h"],
        ["svd_eigen_kernels.h"],
        [build.svd_eigen_declarations()],
        [build.svd_eigen_object()],
    )


def stored_by_columns(A: Array) -> Array:
    """Return matrices (..., 3, 3) stored by columns, (n, 9), as the C functions take them."""
    return np.ascontiguousarray(np.swapaxes(A, -1, -2)).reshape(-1, 9)


def svd(F: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Return the rotation-variant SVD F = U diag(sigma) V^T (Smith et al. 2018, eq. 2).

    Parameters
    ----------
    F : (..., 3, 3)
        Matrices.

    Returns
    -------
    U : (..., 3, 3)
        Rotations, det U = 1.
    sigma : (..., 3)
        Signed singular values, sigma_0 >= sigma_1 >= abs(sigma_2).
    V : (..., 3, 3)
        Rotations, det V = 1.
    """
    F = np.asarray(F, dtype=np.float64)
    columns = stored_by_columns(F)
    U, s, V = (np.empty((len(columns), size)) for size in (9, 3, 9))
    ffi, lib = _svd_eigen_library()
    lib.svd_points(len(columns), *(build.pointer(ffi, a) for a in (columns, U, s, V)))
    rows = [np.swapaxes(a.reshape(F.shape), -1, -2) for a in (U, V)]
    return rows[0], s.reshape(F.shape[:-1]), rows[1]


def eigen3(A: npt.ArrayLike, eigensolver: str = EIGENSOLVERS[0]) -> tuple[Array, Array]:
    """Return eigenvalues and eigenvectors of symmetric 3x3 matrices.

    Parameters
    ----------
    A : (..., 3, 3)
        Symmetric matrices.
    eigensolver : str
        "cubic" or "jacobi".

    Returns
    -------
    values : (..., 3)
        Descending.
    vectors : (..., 3, 3)
        In columns.
    """
    A = np.asarray(A, dtype=np.float64)
    solver = EIGENSOLVERS.index(choose("eigensolver", eigensolver, EIGENSOLVERS))
    packed = np.ascontiguousarray(A.reshape(-1, 9)[:, [0, 4, 8, 1, 2, 5]])
    e, Q = (np.empty((len(packed), size)) for size in (3, 9))
    ffi, lib = _svd_eigen_library()
    a, b, c = (build.pointer(ffi, x) for x in (packed, e, Q))
    lib.eigen3_points(len(packed), a, solver, b, c)
    return e.reshape(A.shape[:-1]), np.swapaxes(Q.reshape(A.shape), -1, -2)


class Material:
    """A hyperelastic material with numerical constants.

    Every F is an array (..., 3, 3); the methods are vectorised over the leading axes.

    Parameters
    ----------
    numbers : Numbers
        The numbers of its energy.
    make_expression : callable
        Returns the energy as an expression; it is called when the expression is needed.

    Attributes
    ----------
    numbers : Numbers
        The numbers of its energy: E, nu, constants and shape parameters.
    constants : (n,)
        The constants that the kernels use [Pa].
    """

    def __init__(self, numbers: Numbers, make_expression: Callable[[], Energy]) -> None:
        self.numbers, self._make_expression = numbers, make_expression
        self.constants = np.array(numbers.values)

    @classmethod
    def of(cls, energy: Energy, key: str | None = None) -> Material:
        """Return the material of an energy; ``key`` is that of its numbers in the cache."""
        return cls(numbers_of(energy, key), lambda: energy)

    def __repr__(self) -> str:
        n = self.numbers
        values = ", ".join(f"{c}={v:g}" for c, v in zip(n.constants, n.values, strict=True))
        return f"<{n.name}: E={n.E:g}, nu={n.nu:g}; {values}>"

    @cached_property
    def expression(self) -> Energy:
        """The normalised energy, a sympy expression with its constants."""
        return self._make_expression()

    @property
    def name(self) -> str:
        """The material's name."""
        return self.numbers.name

    @property
    def has_energy(self) -> bool:
        """Whether the stress is the gradient of an energy."""
        return self.numbers.has_energy

    @property
    def lame(self) -> tuple[float, float]:
        """(mu_lame, lambda_lame) [Pa], linearised from the energy (Chen & Barbic, eq. 3 and 4)."""
        return self.numbers.lame

    @cached_property
    def _kernel(self) -> tuple[Any, Any, Array]:
        """Return the compiled kernels and their parameters; raise BadInput at nu = 0.5."""
        compiled = compile_kernel(self, after=POINTWISE)
        parameters = compiled.constants.values[len(self.numbers.values) :]
        return *build.load(compiled.path, header("pointwise_api.h")), np.array(parameters)

    def _call(self, name: str, F: npt.ArrayLike, *arguments: Any, sizes: tuple[int, ...]) -> Any:
        """Call the C function ``name`` at every F; return an array (..., size) for each size."""
        F = np.asarray(F, dtype=np.float64)
        if F.shape[-2:] != (3, 3):
            raise ValueError(f"F has shape {F.shape}; it must end in (3, 3)")
        shape, n = F.shape[:-2], int(np.prod(F.shape[:-2]))
        columns = stored_by_columns(F)
        out = [np.empty((n, size)) for size in sizes]
        ffi, lib, parameters = self._kernel
        scalars = np.append(self.constants, parameters)
        if n:
            given, found, *results = (build.pointer(ffi, a) for a in (scalars, columns, *out))
            getattr(lib, name)(given, n, found, *arguments, *results)
        return [a.reshape(*shape, a.shape[1]) for a in out]

    def energy(self, F: npt.ArrayLike) -> Array:
        """Return the energy density psi(F) [Pa], (...); +inf outside the energy's domain.

        Raises
        ------
        BadInput
            If the material is defined by a stress and has no energy.
        """
        if not self.has_energy:
            raise BadInput(f"material '{self.name}' has no energy, only a stress")
        return self._call("energy_points", F, sizes=(1,))[0][..., 0]

    def pk1(self, F: npt.ArrayLike) -> Array:
        """Return the first Piola-Kirchhoff stress dpsi/dF [Pa], (..., 3, 3); 0 where psi is inf."""
        P = self._call("stress_points", F, sizes=(9,))[0]
        return np.swapaxes(P.reshape(*P.shape[:-1], 3, 3), -1, -2)

    def hessian(
        self, F: npt.ArrayLike, filter: str = "exact", eigensolver: str = EIGENSOLVERS[0]
    ) -> Array:
        """Return the Hessian d2psi/dF2 [Pa] on vec(F) by columns (Smith et al. 2018, eq. 17, 20).

        Parameters
        ----------
        F : (..., 3, 3)
            Deformation gradients.
        filter : str
            What to do with negative eigenvalues: "exact" keeps them, "clamp" replaces them by 0
            (Smith et al. 2018), "abs" by their absolute values; "objective" clamps, and then
            projects out the spins W F with a skew-symmetric W.
        eigensolver : str
            Solver for the 3x3 scaling block: "cubic" (Smith et al. 2018, eq. 42) or "jacobi".

        Returns
        -------
        (..., 9, 9)
        """
        which = POINT_FILTERS.index(choose("filter", filter, POINT_FILTERS))
        solver = EIGENSOLVERS.index(choose("eigensolver", eigensolver, EIGENSOLVERS))
        C = self._call("hessian_points", F, which, solver, sizes=(81,))[0]
        return C.reshape(*C.shape[:-1], 9, 9)

    def eigensystem(
        self, F: npt.ArrayLike, eigensolver: str = EIGENSOLVERS[0]
    ) -> tuple[Array, Array]:
        """Return eigenvalues and eigenvectors of the exact Hessian in closed form.

        Parameters
        ----------
        F : (..., 3, 3)
            Deformation gradients.
        eigensolver : str
            As for `hessian`.

        Returns
        -------
        values : (..., 9)
            Eigenvalues [Pa]: scaling 0-2 (descending), twist 3-5, flip 6-8 (Smith et al. 2018,
            eq. 45-48).
        vectors : (..., 9, 9)
            Eigenvectors in columns, on vec(F) by columns (Smith et al. 2018, eq. 39 and 62).
        """
        solver = EIGENSOLVERS.index(choose("eigensolver", eigensolver, EIGENSOLVERS))
        values, vectors = self._call("eigensystem_points", F, solver, sizes=(9, 81))
        return values, np.swapaxes(vectors.reshape(*values.shape, 9), -1, -2)

    def ufl(self, F: Any) -> Any:
        """Return psi(F) [Pa] as a UFL expression of the deformation gradient ``F``.

        Parameters
        ----------
        F : ufl.core.expr.Expr
            Deformation gradient, shape (3, 3); `ufl.variable` to differentiate by it.

        Raises
        ------
        BadInput
            If the material is defined by a stress and has no energy.

        Notes
        -----
        UFL's first and second derivative are those of `pk1` and `hessian`, also at equal stretches
        and for an inverted F. An energy of the principal stretches has the form of
        `fem_snh.kernels.ufl_forms`: a relative accuracy of 1e-12 while no stretch is more
        than 30 times another, wrong third derivatives, and a size that only compilers of forms can
        handle: evaluate it by ``dolfinx.fem.Expression``, not by UFL's ``psi(point)``. Outside the
        energy's domain the value is NaN. Where the energy has no Hessian (`arap`, `corotational`
        and `fixed_corotational` where two signed stretches sum to zero), neither has the
        expression.
        """
        from fem_snh.kernels.ufl_forms import energy_density  # imports UFL

        return energy_density(self.expression, F)

    def report(self) -> Report:
        """Return the stress curves, the stability and the admissible region of this material."""
        from fem_snh.kernels.reports.report import report  # imports scipy

        return report(self)


#: E and nu that are not given; None is no number.
_FROM_CONSTANTS: Any = ...


def material(
    name: str | Callable[..., Any],
    E: float = _FROM_CONSTANTS,
    nu: float = _FROM_CONSTANTS,
    **shape: Any,
) -> Material:
    """Return a material, normalised to (E, nu).

    Parameters
    ----------
    name : str or callable
        A name of `fem_snh.materials()`, a reference ``FILE.py:FUNCTION``, or a function of the
        user's own (see `fem_snh.materials`).
    E : float, optional
        Young's modulus [Pa]. By default that of the constants among the keywords; 1 without them.
    nu : float, optional
        Poisson's ratio, in (-1, 0.5]; likewise, or 0.49.
    **shape : Any
        Shape parameters of the material, its constants (``mu``, ``C10``, ``D1``: `fem-snh help
        NAME` lists them) and the keywords of every material
        (`fem_snh.materials.parameters.TUNING`).

    Raises
    ------
    BadInput
        For an unknown name or parameter, constants that contradict E and nu or do not determine
        them, or a function that does not define a material.
    """

    young = None if E is _FROM_CONSTANTS else E
    ratio = None if nu is _FROM_CONSTANTS else nu

    def make() -> Energy:
        return materials.make_energy(name, young, ratio, **shape)  # imports sympy

    check_constants(1.0 if E is _FROM_CONSTANTS else E, 0.0 if nu is _FROM_CONSTANTS else nu)
    if numbers := stored(name, young, ratio, **shape):
        return Material(numbers, make)
    made = Material.of(make(), stored_key(name, young, ratio, shape))
    store(made.numbers)
    return made
