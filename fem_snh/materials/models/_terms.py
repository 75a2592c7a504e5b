"""Terms that several energies share."""

from sympy import Rational, log

from fem_snh.errors import choose


def first_invariant(I_C, J):
    """Return J^(-2/3) I_C, the trace of C for the isochoric deformation J^(-1/3) F."""
    return J ** Rational(-2, 3) * I_C


def second_invariant(II_C, J):
    """Return J^(-4/3) II_C, the second invariant of C for the isochoric deformation."""
    return J ** Rational(-4, 3) * II_C


def quadratic(strains, mu, lam):
    """Return mu sum e_i^2 + lam/2 (sum e_i)^2 for principal strains with e(1) = 0 and e'(1) = 1.

    The Seth-Hill and Hill families (Chen & Barbic, Table 1), with mu = mu_lame, lam = lambda_lame.
    """
    return mu * sum(e**2 for e in strains) + lam / 2 * sum(strains) ** 2


def volume_term(J, lam, kind: str = "J"):
    """Return the volume term ``kind``: "J" is lam/2 (J - 1)^2, "log" is lam/2 (log J)^2.

    Families whose energy has nu = 0 need a volume term (Chen & Barbic, section 6). Raises BadInput
    for another ``kind``.
    """
    strain = J - 1 if choose("volume term", kind, ["J", "log"]) == "J" else log(J)
    return lam / 2 * strain**2
