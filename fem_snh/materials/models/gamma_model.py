"""The material ``gamma_model``."""

from fem_snh.materials.parsing import parse


def gamma_model(I_C, J, mu, lam, *, length: str = "(I_C - 3) / 2", volume: str = "(J - 1)**2 / 2"):
    """Any energy of I_C and J, made stable at rest (Smith et al. 2018, eq. 52).

    ::

        psi = mu length(I_C) + lam volume(J) - p (J - 1),  p such that P(I) = 0

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa].
    length : str
        Expression in I_C with numbers, + - * / ** ( ), log, exp, sqrt.
    volume : str
        Expression in J with the same operations.

    Notes
    -----
    The defaults are the stable Neo-Hookean energy (eq. 13).

    In eq. 52, A = gamma_I I + gamma_F f f^T + gamma_G g g^T + gamma_H H with gamma_I = 2 dpsi/dI_C,
    gamma_F = 4 d2psi/dI_C2, gamma_G = d2psi/dJ2, gamma_H = dpsi/dJ. The eigenvalues are gamma_I +-
    gamma_H s_i and the three eigenvalues of a 3x3 block.
    """
    f = parse("length", length, {"I_C": I_C})
    g = parse("volume", volume, {"J": J})
    slope = 2 * mu * f.diff(I_C).subs(I_C, 3) + lam * g.diff(J).subs(J, 1)
    return mu * f + lam * g - slope * (J - 1)
