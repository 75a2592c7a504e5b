"""A material's compiled kernels, and its values at given deformation gradients.

`Material` and `material` are public: ``fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)``.
`svd` and `eigen3` are the kernels' singular value decomposition and eigensolvers, for arrays.

The functions of a material at a point are compiled to one object file, the loops of an element to
another that does not depend on the material; both are linked to a library. sympy, which generates
the functions, takes longer to import than a small solve. Three records in the cache
(`fem_snh.cache`) therefore name the library of a built-in material on an element, the object file
of the material, and the object file of an expression, which materials share that differ only in the
values of E and nu.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fem_snh import cache, materials
from fem_snh.arrays import Array, ArrayLike
from fem_snh.choices import EIGENSOLVERS, POINT_FILTERS
from fem_snh.errors import BadInput, choose
from fem_snh.kernels import build
from fem_snh.kernels.build import POINTWISE, header, loops_source, svd_eigen_object
from fem_snh.materials.numbers import Numbers, numbers_of, store, stored, stored_key
from fem_snh.materials.parameters import BOUNDS, Function, check_constants

if TYPE_CHECKING:
    from _cffi_backend import FFI, Lib

    from fem_snh.kernels.codegen.source import ElementEnergy
    from fem_snh.kernels.reports.report import Report
    from fem_snh.materials.energy import Energy


@lru_cache
def _svd_eigen_library() -> tuple[FFI, Lib]:
    """Return (ffi, library) of the compiled SVD and eigensolvers."""
    return build.open_library(
        ["svd_eigen_api.h"],
        ["svd_eigen_kernels.h"],
        [build.svd_eigen_declarations()],
        [build.svd_eigen_object()],
    )


def stored_by_columns(A: Array) -> Array:
    """Return a copy of matrices (..., 3, 3) stored by columns, (n, 9), as C functions take them."""
    return np.ascontiguousarray(np.swapaxes(A, -1, -2)).reshape(-1, 9)


def svd(F: ArrayLike) -> tuple[Array, Array, Array]:
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


def eigen3(A: ArrayLike, eigensolver: str = EIGENSOLVERS[0]) -> tuple[Array, Array]:
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
        Eigenvalues, descending.
    vectors : (..., 3, 3)
        Unit eigenvectors, in columns.
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
        The numbers of the material's energy: E, nu, constants and shape parameters.
    make_expression : callable
        Returns the energy as an expression; it is called when the expression is needed.

    Attributes
    ----------
    constants : (n,)
        Values of the material's constants [Pa], which the kernels use.
    """

    def __init__(self, numbers: Numbers, make_expression: Callable[[], Energy]) -> None:
        self.numbers, self._make_expression = numbers, make_expression
        self.constants = np.array(numbers.values)

    @classmethod
    def of(cls, energy: Energy, key: str | None = None) -> Material:
        """Return the material of an energy; ``key`` is the cache key of its numbers, if any."""
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
    def _kernel(self) -> tuple[FFI, Lib]:
        """Return (ffi, library) of the compiled kernels; raise BadInput at nu = 0.5."""
        path = compile_kernel(self, after=POINTWISE).path
        return build.load(path, header("pointwise_api.h"))

    def _call(
        self, name: str, F: ArrayLike, *arguments: int, sizes: tuple[int, ...]
    ) -> list[Array]:
        """Call the C function ``name`` at every F; return an array (..., size) for each size."""
        F = np.asarray(F, dtype=np.float64)
        if F.shape[-2:] != (3, 3):
            raise ValueError(f"F has shape {F.shape}; it must end in (3, 3)")
        shape, n = F.shape[:-2], int(np.prod(F.shape[:-2]))
        columns = stored_by_columns(F)
        out = [np.empty((n, size)) for size in sizes]
        ffi, lib = self._kernel
        if n:
            arrays = (self.constants, columns, *out)
            given, found, *results = (build.pointer(ffi, a) for a in arrays)
            getattr(lib, name)(given, n, found, *arguments, *results)
        return [a.reshape(*shape, a.shape[1]) for a in out]

    def energy(self, F: ArrayLike) -> Array:
        """Return the energy density psi(F) [Pa], (...); +inf outside the energy's domain.

        Raises
        ------
        BadInput
            If the material is defined by a stress and has no energy.
        """
        if not self.has_energy:
            raise BadInput(f"material '{self.name}' has no energy, only a stress")
        return self._call("energy_points", F, sizes=(1,))[0][..., 0]

    def pk1(self, F: ArrayLike) -> Array:
        """Return the first Piola-Kirchhoff stress dpsi/dF [Pa], (..., 3, 3); 0 where psi is inf."""
        P = self._call("stress_points", F, sizes=(9,))[0]
        return np.swapaxes(P.reshape(*P.shape[:-1], 3, 3), -1, -2)

    def hessian(
        self, F: ArrayLike, filter: str = "exact", eigensolver: str = EIGENSOLVERS[0]
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

    def eigensystem(self, F: ArrayLike, eigensolver: str = EIGENSOLVERS[0]) -> tuple[Array, Array]:
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
        UFL's first and second derivatives agree with `pk1` and `hessian`, also at equal stretches
        and for an inverted F. An energy of the principal stretches has the form of
        `fem_snh.kernels.ufl_forms`: its relative accuracy is 1e-12 while no stretch is more than 30
        times another, its third derivatives are wrong, and only form compilers can handle its size:
        evaluate it by ``dolfinx.fem.Expression``, not by UFL's ``psi(point)``. Outside the energy's
        domain the value is NaN. Where the energy has no Hessian (`arap`, `corotational` and
        `fixed_corotational` where two signed stretches sum to zero), neither has the expression.
        """
        from fem_snh.kernels.ufl_forms import energy_density  # imports UFL

        return energy_density(self.expression, F)

    def report(self) -> Report:
        """Return the stress curves, the stability and the admissible region of this material."""
        from fem_snh.kernels.reports.report import report  # imports scipy

        return report(self)


#: The default of E and nu; None is refused, because it is not a number.
_FROM_CONSTANTS: Any = ...


def material(
    name: str | Function,
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
        Young's modulus [Pa]. By default, the constants among the keywords determine E; without
        constants it is 1.
    nu : float, optional
        Poisson's ratio in (-1, 0.5]. By default, the constants determine nu; without constants it
        is 0.49.
    **shape : Any
        Shape parameters and constants of the material (``mu``, ``C10``, ``D1``: ``fem-snh help
        NAME`` lists them), and the keywords of every material
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


class ElementConstants(NamedTuple):
    """The numbers of the energy that an element evaluates.

    Attributes
    ----------
    values : tuple of float
        Constants of the energy [Pa], in the kernels' order.
    volume_stiffness : float
        U''(1) of the volume term [Pa]; inf at nu = 0.5, 0 if nothing is split off.
    lambda_local : float
        The Lame constant lambda that remains in psi' [Pa]; 0 if nothing is split off.
    """

    values: tuple[float, ...]
    volume_stiffness: float = 0.0
    lambda_local: float = 0.0


class Compiled(NamedTuple):
    """The path of a compiled library or object file, and the numbers of its energy."""

    path: Path
    constants: ElementConstants


def compile_kernel(
    material: Material,
    volume: str = "pointwise",
    definitions: Sequence[str] = (),
    after: Sequence[str] = (),
    entries: Sequence[int] = (),
) -> Compiled:
    """Return the library of a material's kernel, compiled unless cached. Not collective.

    Parameters
    ----------
    material : Material
        The material.
    volume : str
        The element's volume treatment, one of `fem_snh.assembly.elements`.
    definitions : sequence of str
        As for `fem_snh.kernels.build.loops_source`.
    after : sequence of str
        Names of the files with the loops, as for `fem_snh.kernels.build.loops_source`.
    entries : sequence of int
        As for `fem_snh.kernels.codegen.source.point_source`.

    Raises
    ------
    BadInput
        If the volume treatment does not support the material, or the compiler fails.
    """

    def link() -> Compiled:
        with ThreadPoolExecutor() as pool:  # the compiler works while sympy generates the point
            common = [
                pool.submit(build.object_file, loops_source(definitions, after)),
                pool.submit(svd_eigen_object),
            ]
            point = _compile_point(material, volume, entries)
        objects = [point.path, *(each.result() for each in common)]
        return Compiled(build.linked(objects), point.constants)

    what = "library", [*definitions], [*after], [*entries]
    return _recorded(_key(material, volume, *what), link)


def _compile_point(material: Material, volume: str, entries: Sequence[int]) -> Compiled:
    """Return the object file of a material's functions at a point, compiled unless cached."""

    def generate() -> Compiled:
        from fem_snh.kernels.codegen.source import element_energy

        chosen = element_energy(material.expression, volume)
        return Compiled(_object_file(chosen, entries), chosen.constants)

    return _recorded(_key(material, volume, "point", [*entries]), generate)


def _recorded(key: str | None, make: Callable[[], Compiled]) -> Compiled:
    """Return the file that the cache's record ``key`` names; if missing, make and record it."""
    if key and (record := cache.read(key)) and (path := build.stored(record.pop("file"))):
        return Compiled(path, ElementConstants(tuple(record.pop("values")), **record))
    made = make()
    if key:
        cache.write(key, {"file": made.path.name, **made.constants._asdict()})
    return made


def supports(material: Material, volume: str) -> bool:
    """Return whether an element with this volume treatment can use a material. Not collective.

    The answer needs sympy, so the cache keeps it.
    """
    key = _key(material, volume, "supports")
    if key and (record := cache.read(key)):
        return bool(record["supported"])
    from fem_snh.kernels.codegen.source import element_energy

    try:
        element_energy(material.expression, volume)
        supported = True
    except BadInput:
        supported = False
    if key:
        cache.write(key, {"supported": supported})
    return supported


def _object_file(chosen: ElementEnergy, entries: Sequence[int]) -> Path:
    """Return the object file of an expression, generated and compiled unless cached."""
    from fem_snh.kernels.codegen.source import point_source

    def generate() -> Compiled:
        source = point_source(chosen.energy, entries, chosen.functions)
        return Compiled(build.object_file(source), chosen.constants)

    what = chosen.energy.as_text(), chosen.functions, [*entries]
    return _recorded(cache.key(what, _made_by()), generate).path


def _key(material: Material, volume: str, *what: object) -> str | None:
    """Return the cache key of the record ``what`` on a material; None for a user's material."""
    if material.numbers.key is None:
        return None
    return cache.key(material.numbers.key, volume, BOUNDS.get(volume), what, _made_by())


def _made_by() -> tuple[str, ...]:
    """Return texts that identify the generator's source, sympy's version and the compiler."""
    return cache.sources("materials", "kernels"), _sympy_version(), build.fingerprint()


@lru_cache
def _sympy_version() -> str:
    """Return the version of sympy without importing sympy."""
    return version("sympy")
