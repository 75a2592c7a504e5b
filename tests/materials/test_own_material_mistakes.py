"""Functions that do not define a material: one line with the function and what is expected."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
import sympy
from sympy import Symbol, log

import fem_snh
from fem_snh import BadInput, cli, materials

pytestmark = pytest.mark.one_debian


def number(I_C, J, mu, lam):
    return 1.0


def nothing(I_C, J, mu, lam):
    mu * (I_C - 3)


def text(I_C, J, mu, lam):
    return "mu * (I_C - 3)"


def raises(I_C, J, mu, lam):
    return mu * math.log(J) + lam * I_C


def foreign(I_C, J, mu, lam):
    return mu * (I_C - 3) + lam * (J - 1) ** 2 * Symbol("k")


def sine(I_C, J, mu, lam):
    return mu * (I_C - 3) - 2 * mu * sympy.sin(J - 1) + lam * (J - 1) ** 2


def exponent(I_C, J, mu, lam):
    return mu * (I_C - 3) + J**lam


def infinite(I_C, J, mu, lam, *, at=0):
    return mu * (I_C - 3) - 2 * mu * log(J) + lam * (J - 1) ** 2 / Symbol("at").subs("at", at)


def large_exponent(I_C, J, mu, lam):
    return mu * (I_C - 3) - 2 * mu * log(J) + lam * (J - 1) ** 1000


def stressed(I_C, J, mu, lam):
    return mu / 2 * (I_C - 3) + lam / 2 * (J - 1) ** 2


def unknown_measure(I_1, J, mu, lam):
    return mu / 2 * (I_1 - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def unknown_invariant(I_Q, J, mu, lam):
    return mu / 2 * (I_Q - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def constant_first(mu, I_C, J, lam):
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def no_measure(mu, lam):
    return mu + lam


def of_anything(*arguments):
    return arguments[0]


def taken(I_C, J, mu, lam, *, alpha=1.0):
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def no_default(I_C, J, mu, lam, *, k):
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def no_constant(I_C, J):
    return (I_C - 3) / 2 - log(J)


def three_constants(I_C, J, a, b, c):
    return a / 2 * (I_C - 3) - a * log(J) + b / 2 * log(J) ** 2 + c * (J - 1) ** 2


def anisotropic(s0, s1, s2, mu, lam):
    return mu * ((s0 - 1) ** 2 + 2 * (s1 - 1) ** 2) + lam / 2 * (s0 + s1 + s2 - 3) ** 2


MISTAKES = [
    (number, r"its function returns 1.0: expected a sympy expression in I_C, J"),
    (nothing, r"its function returns None: expected a sympy expression"),
    (text, r"its function returns 'mu \* \(I_C - 3\)': expected a sympy expression"),
    (raises, r"its function fails: TypeError: .*expected sympy's"),
    (foreign, r"unknown symbol k: expected"),
    (sine, r"function sin: expected .*log, exp, sqrt"),
    (exponent, r"exponent lam in J\*\*lam: expected a number"),
    (infinite, r"its function returns .*: expected an expression that is real and finite"),
    (large_exponent, r"exponent 1000: expected a number from -64 to 64"),
    (stressed, r"stress 0.769 E at rest .F = I.: expected"),
    (unknown_measure, r"argument 'I_1': expected a measure among I_C .tr C."),
    (unknown_invariant, r"argument 'I_Q': expected a measure among I_C .tr C."),
    (constant_first, r"argument 'mu': expected a measure among .*; the constants follow"),
    (no_measure, r"expected an argument that is a measure: I_C"),
    (of_anything, r"argument 'arguments': expected measures"),
    (taken, r"argument 'alpha': expected another name"),
    (no_default, r"shape parameter 'k': expected a default"),
    (no_constant, r"has no free constant"),
    (three_constants, r"has the free constants a, b, c, .*: pin a, b, c or give defaults"),
    (anisotropic, r"is not symmetric in s0, s1, s2: expected an isotropic energy"),
]


@pytest.mark.parametrize(("function", "message"), MISTAKES, ids=[f.__name__ for f, _ in MISTAKES])
def test_mistakes_in_functions(function, message):
    with pytest.raises(BadInput, match=f"^material '{function.__name__}'.*{message}") as caught:
        fem_snh.material(function, nu=0.3)
    assert "\n" not in str(caught.value)


def test_what_is_no_name_and_no_function():
    with pytest.raises(BadInput, match="material = 3: expected a name or a function"):
        fem_snh.material(3)


FILES = {
    "missing.py:gent": r"material(.name)? = 'missing.py:gent': cannot read missing.py: [^(]*$",
    "gell.py:gel": r"cannot read gell.py: .*did you mean 'gel.py'",
    "gel.py:gle": r"material(.name)? = 'gel.py:gle': gel.py has no function 'gle' .did you mean",
    "gel.py": r"material(.name)? = 'gel.py': expected FILE.py:NAME",
    "gel.py:SIZE": "gel.py:SIZE.*int.*expected a function",
    "broken.py:gel": r"material(.name)? = 'broken.py:gel': .*NameError.*wrong",
    "syntax.py:gel": r"material(.name)? = 'syntax.py:gel': .*SyntaxError",
    "gel.py:gel": "material 'gel.py:gel': its function returns 2: expected a sympy expression",
}


@pytest.mark.parametrize(("reference", "message"), FILES.items(), ids=list(FILES))
@pytest.mark.parametrize("command", ["materials {} --report", "run twist --material {} --cells 2"])
def test_mistakes_in_files(reference, message, command, tmp_path: Path, monkeypatch, capsys):
    (tmp_path / "gel.py").write_text("SIZE = 1\ndef gel(I_C, J, mu, lam):\n    return 2\n")
    (tmp_path / "broken.py").write_text("wrong + 1\n")
    (tmp_path / "syntax.py").write_text("def gel(:\n")
    monkeypatch.chdir(tmp_path)
    assert cli.main(command.format(reference).split()) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(message, error), error


def test_materials_of_the_package_are_not_held_to_the_check_of_the_rest_stress():
    """mooney_length is stressed at rest, as published (Smith et al. 2018, eq. 8)."""
    assert materials.make_energy("mooney_length", nu=0.3).rest_stress > 0.1
