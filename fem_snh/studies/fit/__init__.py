"""Fit materials to test data: the command ``fit`` and `fem_snh.fit`.

`data` reads files, `family` is the energy with unknown parameters, `responses` its stress in the
tests, `least_squares` the search, `stability` the stable range, `result` what is returned.
"""

from fem_snh.studies.fit.data import TestData
from fem_snh.studies.fit.result import Fit
from fem_snh.studies.fit.study import fit, ordered, rank

__all__ = ["Fit", "TestData", "fit", "ordered", "rank"]
