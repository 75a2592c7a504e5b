"""Energy terms: each file has one, with its derivatives.

A problem holds the terms that its scene names, and no others. `Term` is their interface; `Elastic`
also has the Hessian. `mass_matrix` assembles the mass matrix, for eigenfrequencies.
"""

from fem_snh.terms.elastic import Elastic
from fem_snh.terms.mass import mass_matrix
from fem_snh.terms.term import Term
from fem_snh.terms.traction import Traction
from fem_snh.terms.ufl_term import UFLTerm

__all__ = ["Elastic", "Term", "Traction", "UFLTerm", "elastic_term", "mass_matrix"]


def elastic_term(assembly: str) -> type[Elastic]:
    """Return the class of the elastic term of an assembly, one of `fem_snh.choices.ASSEMBLIES`."""
    if assembly == "kernels":
        return Elastic
    from fem_snh.terms.elastic_forms import ElasticForms  # imports sympy

    return ElasticForms
