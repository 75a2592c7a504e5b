"""The material ``stvk``."""


def stvk(I_C, II_C, mu, lam):
    """St. Venant-Kirchhoff energy (Smith et al. 2018, eq. 50).

    ::

        psi = mu ||E||^2 + lam/2 tr(E)^2,  E = (C - I)/2
        ||E||^2 = (I_C^2 - 2 II_C - 2 I_C + 3)/4

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.

    Notes
    -----
    Finite for every F. The energy does not detect reflections: a body turned inside out is at rest.
    The resistance to compression decreases below a stretch of 0.577, where the tangent is not
    positive.
    """
    square = (I_C**2 - 2 * II_C - 2 * I_C + 3) / 4
    return mu * square + lam / 8 * (I_C - 3) ** 2
