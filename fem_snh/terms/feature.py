"""The base of features: tables of scenes that are objects of programs, too."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args

from fem_snh.records.output_fields import OutputField
from fem_snh.tables.validation import Table, with_parameters

if TYPE_CHECKING:
    from fem_snh.terms.body import Body
    from fem_snh.terms.term import Term


class Feature(Table):
    """A table of a scene, or an object of a program, that adds energies or forces to a problem.

    A subclass has the fields of the table and defines `create_term`, or `create_terms` if several
    tables make one term. Reading a scene imports the subclass without PETSc, so these methods
    import what needs PETSc when they are called.

    Attributes
    ----------
    key : str
        The table's key in a scene, and the name of its terms in run.json.
    planar : bool
        Whether the feature supports meshes of two dimensions.
    stateless : bool
        Whether its terms keep nothing from one evaluation to the next, so that two problems may
        share them: cell pressures may then be unknowns.
    releases : bool
        Whether its terms release constrained nodes: they are created before all other terms.
    nodal_fields : mapping of str to OutputField
        The fields at the nodes that a scene with the table may name in ``fields``. The terms then
        define `fem_snh.terms.term.Term.nodal_field`.
    """

    key: ClassVar[str]
    planar: ClassVar[bool] = False
    stateless: ClassVar[bool] = False
    releases: ClassVar[bool] = False
    nodal_fields: ClassVar[Mapping[str, OutputField]] = {}

    @classmethod
    def __pydantic_init_subclass__(cls, **keywords: Any) -> None:
        """Describe the fields in the class's docstring."""
        super().__pydantic_init_subclass__(**keywords)
        cls.__doc__ = with_parameters(cls)

    @property
    def named_groups(self) -> Sequence[tuple[str, Any]]:
        """Pairs of a key that names a physical group, and the group that it names."""
        group = getattr(self, "group", None)
        return [] if group is None else [("group", group)]

    @classmethod
    def check(cls, features: Sequence[Self], scene: Any) -> None:
        """Raise BadInput if the tables of a scene contradict each other or its other keys.

        In a program, ``scene`` has the attributes ``element``, ``time`` (None, or with an
        ``integrator``) and ``obstacle``; every other attribute is None.
        """

    @classmethod
    def goals(cls, features: Sequence[Self]) -> Sequence[str]:
        """Return the names of results that may be goals of an error estimate: one per feature.

        A name that ends in ".force" names a vector. The terms return the same `Term.goals`.
        """
        return []

    @classmethod
    def create_terms(cls, features: Sequence[Self], body: Body) -> Sequence[Term]:
        """Return the terms of all features of this class that a problem has. Collective.

        Raises
        ------
        BadInput
            On every rank, for a feature that does not fit the body.
        """
        return [feature.create_term(body) for feature in features]

    @classmethod
    def describe(cls, features: Sequence[Self], terms: Sequence[Term]) -> Mapping[str, Any]:
        """Return keys of run.json that describe all features of this class. Collective.

        They are written before the first step. ``terms`` is the result of `create_terms`.
        """
        return {}

    def create_term(self, body: Body) -> Term:
        """Return the term of this feature alone. Collective."""
        raise NotImplementedError(f"{type(self).__name__}.create_term")


def grouped(features: Iterable[Any]) -> Iterator[tuple[type[Any], list[Any]]]:
    """Yield each class of features with the list of its features, in order of first occurrence.

    An object that is no feature, such as a term, is yielded alone, with its own class.
    """
    given = list(features)
    for number, feature in enumerate(given):
        kind = type(feature)
        if not isinstance(feature, Feature):
            yield kind, [feature]
        elif not any(type(earlier) is kind for earlier in given[:number]):
            yield kind, [other for other in given if type(other) is kind]


def create_terms(features: Iterable[Any], body: Body) -> list[Term]:
    """Return the terms that features create, and given terms unchanged. Collective.

    The features of one class create terms together, those with ``releases`` first; the result has
    the order of `grouped`.

    Parameters
    ----------
    features : iterable of Feature or Term
        The features and terms.
    body : Body
        The body that they act on.
    """
    groups = list(grouped(features))
    made: dict[int, Sequence[Term]] = {}
    for i in sorted(range(len(groups)), key=lambda i: not getattr(groups[i][0], "releases", False)):
        kind, given = groups[i]
        made[i] = kind.create_terms(given, body) if issubclass(kind, Feature) else given
    return [term for i in range(len(groups)) for term in made[i]]


def feature_classes(tables: type[Table]) -> Iterator[type[Feature]]:
    """Yield the feature classes that are types of a table's fields, in the order of the fields."""
    for field in tables.model_fields.values():
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, Feature):
                yield kind
