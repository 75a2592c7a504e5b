"""Element kernels of a compiled form: the addresses of FFCx's functions, and their arguments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from dolfinx import cpp, fem

_TYPES = fem.IntegralType if hasattr(fem, "IntegralType") else cpp.fem.IntegralType
#: Kinds of integrals that have element matrices of one cell.
_KINDS = ("cell", "exterior_facet")


@dataclass(frozen=True)
class FormIntegral:
    """One integral of a compiled form on this rank.

    Attributes
    ----------
    kernel : int
        Address of FFCx's ``tabulate_tensor``.
    entities : (n,) or (n, 2) int32
        Cells of this rank, or pairs of a cell and the local number of its exterior facet.
    key : tuple
        Key of the integral's coefficients in the result of `pack`.
    """

    kernel: int
    entities: np.ndarray
    key: tuple[Any, int]


def integrals(compiled: Any) -> list[FormIntegral]:
    """Return the integrals over cells and exterior facets that have entities on this rank."""
    form = _cpp(compiled)
    found = []
    for name in _KINDS:
        kind = getattr(_TYPES, name)
        for i, (number, integral) in enumerate(_ufcx_integrals(compiled.ufcx_form, kind.value)):
            # By subdomain id up to 0.9, by index since 0.10.
            which = number if hasattr(form, "integral_ids") else i
            entities = np.ascontiguousarray(form.domains(kind, which), np.int32)
            kernel = int(_ffi().cast("uintptr_t", integral.tabulate_tensor_float64))
            if len(entities):
                found.append(FormIntegral(kernel, entities, (kind, which)))
    return found


def kernel_arguments(compiled: Any) -> int:
    """Return the number of arguments of a form's kernels: 6 up to 0.9, then 7; 0: no kernels."""
    for name in _KINDS:
        kind = getattr(_TYPES, name)
        for _, integral in _ufcx_integrals(compiled.ufcx_form, kind.value):
            return len(_ffi().typeof(integral.tabulate_tensor_float64).args)
    return 0


def pack(compiled: Any) -> tuple[np.ndarray, dict[tuple[Any, int], np.ndarray]]:
    """Return the present values of a form's constants and coefficients.

    Coefficients are a dict by `FormIntegral.key` of arrays with one row for each entity.
    """
    form = _cpp(compiled)
    constants = np.ascontiguousarray(cpp.fem.pack_constants(form))
    packed = cpp.fem.pack_coefficients(form)
    return constants, {key: np.ascontiguousarray(rows) for key, rows in packed.items()}


@lru_cache
def _ffi() -> Any:
    import cffi  # slow to import, and only forms that FFCx compiles need it

    return cffi.FFI()


def _cpp(compiled: Any) -> Any:
    """Return the C++ form: in 0.5 the form itself."""
    return getattr(compiled, "_cpp_object", compiled)


def _ufcx_integrals(ufcx: Any, kind: int) -> list[tuple[int, Any]]:
    """Return (subdomain id, ufcx_integral) of the integrals of one kind."""
    if hasattr(ufcx, "form_integrals"):  # since 0.7
        first, last = ufcx.form_integral_offsets[kind], ufcx.form_integral_offsets[kind + 1]
        return [(ufcx.form_integral_ids[k], ufcx.form_integrals[k]) for k in range(first, last)]
    ids, found = ufcx.integral_ids(kind), ufcx.integrals(kind)
    return [(ids[k], found[k]) for k in range(ufcx.num_integrals(kind))]
