"""Stable Neo-Hookean flesh simulation in FEniCSx.

    >>> import fem_snh
    >>> m = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)
    >>> m.hessian(F, filter="clamp")  # F (..., 3, 3) -> (..., 9, 9), positive semidefinite
    >>> print(m.report())  # stability, admissible region, stress curves
    >>> fem_snh.fit("mooney_rivlin", "treloar").table()  # a material fitted to test data
    >>> result = fem_snh.run("twist", cells=15, out="out/twist")  # also under mpirun
    >>> fem_snh.NonlinearProblem(u, {m: ufl.dx}, bcs=bcs).solve()  # in a dolfinx program
    >>> fem_snh.DynamicProblem(u, {m: ufl.dx}, {m: 1e3}, duration=1.0).step(0.01)  # in time

Each subpackage uses those before: `materials` (symbolic energies), `geometry` (shapes, motions),
`tables` (what scenes and programs share), `viewing` (pictures), `kernels` (compiled energies, a
material at a point), `mesh`, `linalg` (linear solvers), `solver` (projected Newton, a PETSc SNES),
`assembly`, `terms` (energies and loads), `contact`, `scenes` (experiments), `studies` (many runs),
`problem`, `accuracy`, `steps` (the driver), `runs` (a scene in, a result out), `cli`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fem_snh.errors import BadInput

if TYPE_CHECKING:
    from fem_snh.assembly.unknowns import displacement_space
    from fem_snh.contact.contact_tables import Contact, SelfContact
    from fem_snh.contact.obstacle import Obstacle
    from fem_snh.dynamic_problem import DynamicProblem
    from fem_snh.kernels.material import material
    from fem_snh.nonlinear_problem import NonlinearProblem
    from fem_snh.program_results import estimate_error, modes, reaction
    from fem_snh.runs import Result, run
    from fem_snh.runs.inverse import fit_scene
    from fem_snh.runs.start import interpolate_run
    from fem_snh.scenes import register_feature
    from fem_snh.studies.fit import Fit, fit
    from fem_snh.terms.cavity import Cavity
    from fem_snh.terms.dirichlet import Hold, Move, Symmetry
    from fem_snh.terms.feature import Feature
    from fem_snh.terms.loads import Gravity, Pressure, Spring, Traction
    from fem_snh.terms.rigid import Rigid
    from fem_snh.terms.term import Term

__all__ = [
    "BadInput", "Cavity", "Contact", "DynamicProblem", "Feature", "Fit", "Gravity", "Hold", "Move",
    "NonlinearProblem", "Obstacle", "Pressure", "Result", "Rigid", "SelfContact", "Spring",
    "Symmetry", "Term", "Traction", "displacement_space", "estimate_error", "fit", "fit_scene",
    "interpolate_run", "material", "materials", "modes", "reaction", "register_feature", "run",
]  # fmt: skip

#: Modules of the public names. A module is imported on first use, as importing dolfinx is slow.
_MODULES = {
    "material": "kernels.material",
    "run": "runs",
    "fit": "studies.fit",
    "fit_scene": "runs.inverse",
    "Fit": "studies.fit",
    "interpolate_run": "runs.start",
    "Result": "runs",
    "NonlinearProblem": "nonlinear_problem",
    "displacement_space": "assembly.unknowns",
    "estimate_error": "program_results",
    "modes": "program_results",
    "reaction": "program_results",
    "Obstacle": "contact.obstacle",
    "DynamicProblem": "dynamic_problem",
    "Contact": "contact.contact_tables",
    "SelfContact": "contact.contact_tables",
    "Cavity": "terms.cavity",
    "Feature": "terms.feature",
    "register_feature": "scenes",
    "Gravity": "terms.loads",
    "Pressure": "terms.loads",
    "Rigid": "terms.rigid",
    "Spring": "terms.loads",
    "Hold": "terms.dirichlet",
    "Move": "terms.dirichlet",
    "Symmetry": "terms.dirichlet",
    "Term": "terms.term",
    "Traction": "terms.loads",
}


def __getattr__(name: str) -> Any:
    if name == "materials":
        return import_module(f"{__name__}.materials")
    if name in _MODULES:
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names, also of modules that are not imported yet."""
    return list(__all__)
