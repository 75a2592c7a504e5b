"""Named choices that scenes, kernels and solver share, and their defaults."""

from __future__ import annotations

#: Largest number that scenes and meshes may have, and the inverse of the smallest positive one: the
#: squares of forces, (E V^(2/3))^2, then neither overflow nor underflow, nor do their sums.
LARGEST_NUMBER = 1e50

#: Eigenvalue filters of a Hessian at a quadrature point, in the order of material_point.h.
FILTERS = ("exact", "clamp", "abs")
#: `FILTERS`, and the clamped Hessian without the stiffness of rotations, for damping.
POINT_FILTERS = (*FILTERS, "objective")

#: Hessians of Newton's method: one filter throughout, or ``adaptive``: exact while the linear
#: solver finds it positive definite, filtered when it does not.
HESSIANS = (*FILTERS, "adaptive")

#: Globalizations of Newton's method (Nocedal & Wright 2006, chapters 3 and 4).
GLOBALIZATIONS = ("linesearch", "trust_region")

#: Eigensolvers of the Hessian's 3x3 scaling block: the one that every run uses, and one that tests
#: compare with it (docs/results/eigensolver.md).
EIGENSOLVERS = ("cubic", "jacobi")

#: First guesses of a load step (`fem_snh.solver.predictor`).
PREDICTORS = ("none", "extrapolate", "tangent", "bones")


#: Time integrators (`fem_snh.steps.dynamics.integrators`); newmark has no numerical damping.
INTEGRATORS = ("backward_euler", "newmark", "bdf2", "generalized_alpha", "semi_implicit")

#: Interpolations of a table between its points (`fem_snh.tables.amplitudes`).
INTERPOLATIONS = ("linear", "smooth")

#: Mass matrices (`fem_snh.assembly.nodal_mass`).
MASSES = ("consistent", "lumped")

#: The defaults of scenes, of the command line and of `fem_snh.solver.create` alike.
DEFAULT_HESSIAN = "adaptive"
DEFAULT_PREDICTOR = "extrapolate"
DEFAULT_INTEGRATOR = "newmark"
#: Spectral radius of generalized_alpha at infinite frequency; 1 damps nothing, 0 the most.
DEFAULT_RHO_INFINITY = 0.8

#: The default globalization of each kind of problem, if the user names no Hessian. A trust region
#: requires an energy to minimise.
DEFAULT_GLOBALIZATIONS = {
    "minimisation problem": "trust_region",
    "saddle-point problem": "linesearch",  # Taylor-Hood elements
    "forces without an energy": "linesearch",
}

#: Largest unit of the residual's norm over the largest force that acts. With the default of
#: ``-snes_scaled_tol``, 1e-7, the residual is then at most 1e-4 of that force: Hertz's force is
#: accurate to 1e-5 (`tests/solver/test_acting_forces.py`), the accelerations of a step to 1e-4.
ACTING_FORCES = 1e3

#: How contact with an obstacle is enforced; the first is the default.
CONTACT_METHODS = ("penalty", "augmented_lagrangian")

#: How contact of a body with itself is enforced.
SELF_CONTACT_METHODS = ("reference", "ipc")

#: Default number of cells along the longest extent of a shape from a file, as gmsh chooses.
DEFAULT_CELLS = 10

#: Weights of lattice cells that the body fills in part: the filled fraction, or 1; the default is
#: first.
LATTICE_WEIGHTINGS = ("fraction", "full")

#: The default globalization if the user names a Hessian; with ``clamp`` it is the method of
#: Smith et al. 2018.
GLOBALIZATION_OF_NAMED_HESSIAN = "linesearch"

#: Largest number of L-BFGS iterations after a Newton step, by globalization. In a trust region, a
#: maximum of 640 needs a half to a sixth of the Newton iterations that 40 needs (measured:
#: python -m benchmarks negative_curvature --lbfgs 40,640; docs/results/figures.md).
DEFAULT_LBFGS_MAX_IT = {"linesearch": 0, "trust_region": 640}
#: The same maximum in a trust region with sparse factors, where a Newton step costs as much as
#: a few L-BFGS iterations (measured: python -m benchmarks large_steps, slender).
FACTORS_LBFGS_MAX_IT = 40

#: Where a goal is evaluated that is to be farthest from its value at the start.
LARGEST = "largest"
#: Loads of different paths are the same if they are rounded to so many digits.
LOAD_DIGITS = 9
