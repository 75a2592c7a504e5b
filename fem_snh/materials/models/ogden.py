"""The material ``ogden``."""

from sympy import log

from fem_snh.errors import BadInput
from fem_snh.materials.invariants import exact, positive
from fem_snh.materials.models._terms import volume_term
from fem_snh.materials.registry import LIST, Published


def _modulus(exponents, weights, names):
    """Return the shear modulus, sum w_p a_p / 2; raise BadInput unless it is positive.

    ``names`` are the names of ``exponents`` and ``weights`` in messages.
    """
    if len(exponents) != len(weights) or not exponents:
        raise BadInput(f"{names[0]} = {exponents}: expected as many as {names[1]}, {len(weights)}")
    modulus = sum(w * a for w, a in zip(weights, exponents, strict=True)) / 2
    if 0 in exponents or not modulus > 0:
        raise BadInput(
            f"{names[0]} = {exponents}, {names[1]} = {weights}: expected exponents other than 0 "
            "and a positive sum of the products"
        )
    return modulus


def _from_terms(mu_p, alpha_p):
    """Return the keywords ``exponents``, ``weights`` and ``mu`` from Ogden's constants."""
    modulus = _modulus(alpha_p, mu_p, ("alpha_p", "mu_p"))
    return {"exponents": alpha_p, "weights": tuple(m / modulus for m in mu_p), "mu": modulus}


PUBLISHED = (
    Published(
        {
            "mu_p": "Ogden's moduli [Pa], a list; those of Abaqus, mu_i, are mu_p alpha_p/2.",
            "alpha_p": "Ogden's exponents, a list. mu = sum mu_p alpha_p/2.",
        },
        _from_terms,
        LIST,
    ),
)


def ogden(
    s0,
    s1,
    s2,
    mu,
    lam,
    *,
    exponents: tuple[float, ...] = (1.3, 5.0, -2.0),
    weights: tuple[float, ...] = (6.3, 0.012, -0.1),
    volume: str = "J",
):
    """Ogden energy (Chen & Barbic, Table 1), made free of stress at rest, with a volume term.

    ::

        psi = sum_p mu_p/a_p (s0^a_p + s1^a_p + s2^a_p - 3) - (sum_p mu_p) log J + volume

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    exponents : tuple of float
        The exponents a_p. The default is Ogden's fit to Treloar's rubber.
    weights : tuple of float
        The mu_p up to a factor: mu_p = mu w_p / (sum w_p a_p / 2).
    volume : str
        Volume term: "J" is lam/2 (J - 1)^2, "log" is lam/2 (log J)^2.

    Notes
    -----
    Infinite for J <= 0. Without the volume term nu = 0; the volume term vanishes at nu = 0.

    Without the logarithm, as the table prints the energy, the rest state has the stress sum mu_p,
    and mu_lame = sum mu_p (a_p - 1)/2.

    References
    ----------
    Ogden 1972.
    """
    _modulus(exponents, weights, ("exponents", "weights"))
    powers, shares = ([exact(x) for x in xs] for xs in (exponents, weights))
    modulus = sum(w * a for w, a in zip(shares, powers, strict=True)) / 2
    J = positive(s0 * s1 * s2)
    terms = [
        w / a * (positive(s0) ** a + positive(s1) ** a + positive(s2) ** a - 3)
        for w, a in zip(shares, powers, strict=True)
    ]
    return mu / modulus * (sum(terms) - sum(shares) * log(J)) + volume_term(J, lam, volume)
