"""The material ``stable_arruda_boyce``."""

from fem_snh.materials.invariants import exact


def stable_arruda_boyce(I_C, J, mu, lam, *, betas: tuple[float, ...] = (0.025, 11 / 11200)):
    """Stable Neo-Hookean energy with polynomial hardening (Smith et al. 2018, eq. 57, 58).

    ::

        psi = mu/2 (I_C - 3) + mu beta_1/4 (I_C^2 - 9) + mu beta_2/6 (I_C^3 - 27) + ...
              + lam/2 (J - alpha)^2
        alpha = 1 + mu/lam (1 + 3 beta_1 + 9 beta_2 + ...)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa].
    betas : tuple of float
        (beta_1, beta_2, ...), of any length; term k is mu beta_k/(2 (k+1)) (I_C^(k+1) - 3^(k+1)).
        The default is the expansion of Arruda & Boyce 1993, 1/(5 N) and 11/(175 N^2), for chains of
        N = 8 links. With betas = () it is eq. 13.

    Notes
    -----
    Finite for every F.
    """
    length, pressure = mu / 2 * (I_C - 3), mu
    for k, beta in enumerate(map(exact, betas), start=1):  # P(I) = 0 to the last digit
        length += mu * beta / (2 * (k + 1)) * (I_C ** (k + 1) - 3 ** (k + 1))
        pressure += mu * beta * 3**k
    return length - pressure * (J - 1) + lam / 2 * (J - 1) ** 2
