"""The material ``valanis_landel_new``."""

from fem_snh.materials.models.valanis_landel_xu import valanis_landel_xu


def valanis_landel_new(
    s0, s1, s2, mu, lam, *, length: str = "s * (log(s) - 1)", volume: str = "(J - 1)**2 / 2"
):
    """Valanis-Landel energy of any functions of length and volume (Chen & Barbic, Table 1).

    ::

        psi = mu (sum f(s_i) - f'(1) log J) + lam (h(J) - h'(1) log J)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu_lame = mu (f''(1) + f'(1))/2, lambda_lame = lam (h''(1) + h'(1)).
    length : str
        f as an expression in s with numbers, + - * / ** ( ), log, exp, sqrt.
    volume : str
        h as an expression in J with the same operations.

    Notes
    -----
    Infinite for J <= 0. The logarithms, which are not in the table, make the rest state free of
    stress.

    References
    ----------
    Valanis 2022.

    Chen et al. 2023.
    """
    shapes = {"length": length, "area": "0", "volume": volume}
    return valanis_landel_xu(s0, s1, s2, mu, lam, **shapes)
