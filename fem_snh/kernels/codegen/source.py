"""The whole C source of one material: headers, what is generated for it, what calls that."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

from fem_snh.kernels.codegen.c_functions import Functions
from fem_snh.kernels.codegen.small_strain import VOLUME_CHANGE, NearRest, volume_near_rest
from fem_snh.materials.energy import Energy
from fem_snh.materials.volume_split import PRESSURE, J, Split

#: The parts of the C source, in order; the generated code goes before "material_point.h".
_BEFORE, _AFTER = ("lanes.h", "svd.h", "eigen3.h"), ("material_point.h", "pointwise_api.h")
_HELPERS = ("log_exp_series.h", "divided_differences.h", "small_strain.h", "parameters.h")
_TOOLS = (*_BEFORE, "svd_eigen_api.h")


def volume_curve(split: Split) -> str:
    """C for U(J), U', U'' of a material (volume_mean.h)."""
    head = f"volume_curve(Law p, real J, real {VOLUME_CHANGE}, real *U)"
    curve = split.volume_curve
    return Functions(split.energy).curve_function(head, J, curve, "U", volume_near_rest(curve))


def volume_dual(split: Split) -> str:
    """C for U*(p), J(p), dJ/dp of a material (volume_pressure.h)."""
    head = "volume_dual(Law p, real *dual)"
    return Functions(split.energy).curve_function(head, PRESSURE, split.dual_curve, "dual")


def svd_eigen_source() -> str:
    """Return the C source of the 3x3 SVD and eigensolvers, which depend on no material."""
    folder = files("fem_snh.kernels") / "include"
    return "\n".join(["#include <math.h>", *((folder / name).read_text() for name in _TOOLS)])


def material_source(energy: Energy) -> str:
    """Return the C source of a material's pointwise kernels: energy, stress, Hessian, eigensystem.

    Parameters
    ----------
    energy : Energy
        A normalised energy; ``fem_snh.materials.energy(name, E, nu)`` makes one.
    """
    return kernel_source(energy)


def kernel_source(
    energy: Energy,
    before: Sequence[str] = (),
    after: Sequence[str] = (),
    functions: Sequence[str] = (),
) -> str:
    """The whole C source for ``energy``: headers, generated functions, then the files ``after``.

    ``before`` are lines put at the top (the sizes of an element, say), ``functions`` C that goes
    before the files.
    """
    g, near = Functions(energy), NearRest(energy)
    generated = [g.energy_function("s"), g.gradient_function(), g.hessian_function()]
    if energy.needs_stretches:
        generated += [near.energy_function(), near.gradient_function()]
    else:
        generated += [g.energy_function("F"), g.stress_function()]
        generated += [near.energy_function(), near.stress_function()]
    folder = files("fem_snh.kernels") / "include"
    return "\n".join(
        [
            "#include <math.h>",
            *before,
            f"#define NEEDS_STRETCHES {int(energy.needs_stretches)}",
            f"#define HAS_VOLUME {int(J in energy.measures)}",
            *((folder / name).read_text() for name in (*_BEFORE, *_HELPERS)),
            f"/* generated: {energy.name}, psi = {energy.psi} */",
            *generated,
            *functions,
            *((folder / name).read_text() for name in (*_AFTER, *after)),
        ]
    )
