"""The base of features: tables of scenes that are objects of programs, too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

from fem_snh.tables.validation import Table

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


class Feature(Table):
    """What a scene's table or an object of a program adds to a problem: energies and forces.

    A subclass has the fields of the table and either `create_term`, or `create_terms` if several
    tables make one term. It is imported to read a scene, without PETSc: both import what they need
    when they are called.

    Attributes
    ----------
    key : str
        The table's key in a scene, and the name of its terms in run.json.
    """

    key: ClassVar[str]

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return the terms of all features of this class that a problem has. Collective.

        Raises
        ------
        BadInput
            On every rank, for a feature that does not fit the body.
        """
        return [feature.create_term(body) for feature in features]

    def create_term(self, body: Body) -> Term:
        """Return the term of this feature alone. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.create_term")


def create_terms(features: Iterable[Any], body: Body) -> list[Term]:
    """Return the terms of features and terms, in the order of the first of each class. Collective.

    Parameters
    ----------
    features : iterable of Feature or Term
        Features of one class make their terms together.
    body : Body
        What they act on.
    """
    found: list[Term] = []
    given = list(features)
    for number, feature in enumerate(given):
        kind = type(feature)
        if not isinstance(feature, Feature):
            found.append(feature)
        elif not any(type(earlier) is kind for earlier in given[:number]):
            found += kind.create_terms([other for other in given if type(other) is kind], body)
    return found
