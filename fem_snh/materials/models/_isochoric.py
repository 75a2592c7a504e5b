"""Energies of rubber in the isochoric deformation J^(-1/3) F, and their volume term."""

from sympy import Rational


def first_invariant(I_C, J):
    """Return tr C of the isochoric deformation, J^(-2/3) I_C."""
    return J ** Rational(-2, 3) * I_C


def second_invariant(II_C, J):
    """Return the second invariant of the isochoric C, J^(-4/3) II_C."""
    return J ** Rational(-4, 3) * II_C


def volume(J, kappa):
    """Return kappa/2 (J - 1)^2."""
    return kappa / 2 * (J - 1) ** 2
