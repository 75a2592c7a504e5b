"""Energies that are quadratic in a principal strain."""


def quadratic(strains, mu, lam):
    """Return mu sum e_i^2 + lam/2 (sum e_i)^2 for principal strains with e(1) = 0 and e'(1) = 1.

    The Seth-Hill and Hill families (Chen & Barbic, Table 1), with mu = mu_lame, lam = lambda_lame.
    """
    return mu * sum(e**2 for e in strains) + lam / 2 * sum(strains) ** 2
