"""Compiled kernels: energy, stress and filtered Hessian at quadrature points and over cells."""
