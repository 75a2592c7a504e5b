"""A material at a point: energy, stress, filtered Hessian, UFL form, and its report."""
