"""Files of test data: units, names of columns, tests, and one line for everything that is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import fem_snh
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.studies.fit import TestData, read_all
from fem_snh.studies.fit.data import DATASETS, read


def written(folder: Path, text: str) -> Path:
    path = folder / "data.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "kind", "x", "stress"),
    [
        ("# test = uniaxial\nstretch, stress [MPa]\n1.5, 0.2\n", "uniaxial", 1.5, 2e5),
        ("# Test: Pure shear\nlambda;nominal stress (N/mm²)\n2;0.3\n", "planar", 2.0, 3e5),
        ("# test = ET\nstrain [%]\tPK1 [kPa]\n50\t2\n", "equibiaxial", 1.5, 2e3),
        ("gamma stress\n0.4 0.1\n", "simple_shear", 0.4, 0.1),
        ("# test=uniaxial\nstrain, stress [kgf/cm2], time\n0.5, 2, 7\n", "uniaxial", 1.5, 196133.0),
        ("# test = confined\nstretch, pressure\n0.9, 2\n", "confined", 0.9, -2.0),
        ("test, stretch, stress\ncompression, 0.5, -1\n", "uniaxial", 0.5, -1.0),
        ("# test = uniaxial\n# columns = stretch, stress\n# unit = psi\n1.5, 1\n", "uniaxial", 1.5,
         6894.757293168361),
        ("# columns = test, stretch, stress\npure shear, 1.2, 9\n", "planar", 1.2, 9.0),
        ('# columns = test, stretch, stress\n"Uniaxial", 1.1, .05,\n', "uniaxial", 1.1, 0.05),
    ],
)  # fmt: skip
def test_files(tmp_path: Path, text: str, kind: str, x: float, stress: float) -> None:
    (found,) = read(written(tmp_path, text))
    assert found.kind == kind
    assert found.x == pytest.approx([x], rel=1e-15)
    assert found.stress == pytest.approx([stress], rel=1e-12)


def test_pressure_over_volume(tmp_path: Path) -> None:
    """P = -p J^(2/3): the nominal stress on the faces of a cube of side J^(1/3)."""
    (found,) = read(written(tmp_path, "J, pressure [MPa]\n0.729, 10\n"))
    assert found.kind == "volumetric"
    assert found.x == pytest.approx([0.9], rel=1e-14)
    assert found.stress == pytest.approx([-10e6 * 0.81], rel=1e-14)


def test_biaxial_tests(tmp_path: Path) -> None:
    """Two nominal stresses are two tests; a cell without a value is empty or a dash."""
    text = "strain [%], lambda 2, stress [kPa], stress_2 [MPa]\n50,1.2,30,0.02\n60,1,-,.01\n,,\n"
    with pytest.raises(BadInput, match="line 4: no value of strain, stress or stress_2"):
        read(written(tmp_path, text))
    first, second = read(written(tmp_path, text.replace(",,\n", "70,1,40\n")))
    assert (first.kind, second.kind) == ("biaxial", "biaxial")
    assert (first.name, second.name) == ("data stress", "data stress_2")
    assert (first.measure, second.measure) == ("stress", "stress_2")
    assert first.x == pytest.approx([1.5, 1.7])
    assert second.x == pytest.approx([1.5, 1.6])
    assert second.stretch_2 == pytest.approx([1.2, 1])
    assert first.stress == pytest.approx([3e4, 4e4])
    assert second.stress == pytest.approx([2e4, 1e4])


@pytest.mark.parametrize(
    "names", ["lambda_1, lambda_2, P_1, P_2", "stretch_1, stretch_22, stress_11, stress_22"]
)
def test_names_of_directions(tmp_path: Path, names: str) -> None:
    first, second = read(written(tmp_path, f"{names}\n1.5, 1.2, 3, 2\n"))
    assert (first.kind, first.measure, first.stress[0]) == ("biaxial", "stress", 3)
    assert (second.kind, second.measure, second.stress[0]) == ("biaxial", "stress_2", 2)


def test_a_uniaxial_and_a_biaxial_test_in_a_file(tmp_path: Path) -> None:
    text = "test, stretch, strain_2, stress_difference, stress\nut, 2, , , 3\nbt, 1, 1, -4\n"
    uniaxial, biaxial = read(written(tmp_path, text))
    assert (uniaxial.kind, uniaxial.stress[0], uniaxial.stretch_2) == ("uniaxial", 3, None)
    assert biaxial.measure == "stress_difference"
    assert (biaxial.stress[0], biaxial.stretch_2[0]) == (-4, 2)


@pytest.mark.parametrize(
    "lines",
    [
        "stress\n1, 1.5, 0.3\n",  # stretched in direction 2 alone
        "stress\n0.9, 1.5, -0.1\n",  # a small nu
        "stress\n0.9, 1.5, 0.1\n",  # a large one
        "stress_2\n1.5, 1, 0.3\n",
        "stress_difference\n1, 1.5, -0.3\n",
    ],
)
def test_stresses_of_both_signs_are_possible(tmp_path: Path, lines: str) -> None:
    (found,) = read(written(tmp_path, f"stretch, stretch_2, {lines}"))
    assert found.kind == "biaxial"


def test_options_replace_what_a_file_states(tmp_path: Path) -> None:
    path = written(tmp_path, "# test = uniaxial\nstretch, stress [MPa]\n1.5, 0.2\n")
    (found,) = read(path, test="planar", columns=["stress", "strain"], unit="Pa", weight=3)
    assert (found.kind, found.x[0], found.stress[0], found.weight[0]) == ("planar", 1.2, 1.5, 3)


def test_columns_without_the_last_of_a_file(tmp_path: Path) -> None:
    path = written(tmp_path, "# test = planar\nstretch, stress, stress_2\n1.5, 2, 1\n")
    (found,) = read(path, columns=["stretch", "stress"])
    assert (found.kind, found.x[0], found.stress[0]) == ("planar", 1.5, 2)


def test_a_column_of_tests_and_of_weights(tmp_path: Path) -> None:
    text = "test, stretch, stress, weight\nut, 1.5, 1, 2\nps, 1.2, 0.5, 1\nut, 2, 2, 4\n"
    first, second = read(written(tmp_path, text))
    assert (first.kind, second.kind) == ("uniaxial", "planar")
    assert np.array_equal(first.weight, [2, 4])
    assert first.name == "data uniaxial"


HEAD = "# test = uniaxial\nstretch, stress\n"
BIAXIAL = "# test = biaxial\nstretch, stretch_2, stress_difference\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no line of numbers"),
        ("1.5, 2\n", "no line of column names"),
        ("stretch, stress\n1.5, 2\n", "no test: expected a line '# test = uniaxial|"),
        ("# test = uniaxal\nstretch, stress\n1.5, 2\n", "(did you mean 'uniaxial'?)"),
        ("# test = uniaxial\nstretch, force\n1.5, 2\n", "expected one column stress or pressure"),
        ("# test = uniaxial\nstress\n1.5\n", "expected one column stretch or strain"),
        ("# test = uniaxial\nstretch, true stress\n1.5, 2\n", "expected the nominal stress"),
        ("# test = uniaxial\nstretch, stress [lb]\n1.5, 2\n", "unit = 'lb': expected one of Pa"),
        ("# test = uniaxial\nstretch [mm], stress\n1.5, 2\n", "unit of stretch = 'mm'"),
        (HEAD, "no line of numbers"),
        (HEAD + "1.5\n", "line 3: no value of stress"),
        (HEAD + "1,5, 0,3\n2,1, 0,5\n", "line 3: 4 values for 2 columns: expected one for"),
        ("# test = ut\n# columns = strain, stress\n1.1, n/a\n2, 1\n", "line 3: stress = 'n/a': "),
        (HEAD.replace("stretch", "strain [%]") + "-120, 1\n", "= -120.0: expected a number > -"),
        (HEAD.replace("stress", "stress, weight") + "2, 1, -3\n", "weight = '-3': expected"),
        (HEAD + "1.5, x\n", "line 3: stress = 'x': expected a number"),
        (HEAD + "1.5, nan\n", "line 3: stress = nan: expected a finite number"),
        (HEAD + "0, 1\n", "line 3: stretch = 0.0: expected a number > 0"),
        (HEAD + "1, 0\n", "expected a deformation and a stress other than 0"),
        (HEAD + "0.5, 1\n0.4, 2\n", "every stress has the wrong sign"),
        (HEAD.replace("stress", "pressure") + "0.5, 1\n", "'uniaxial': expected stretch"),
        ("# test = planar\nshear, stress\n1, 1\n", "expected stretch or strain"),
        ("# test = simple_shear\nstretch, stress\n1, 1\n", "expected shear or strain or stress"),
        ("# test = biaxial\nstretch, stress\n1.5, 1\n", "expected a column stretch_2, or test ="),
        ("# test = biaxial\nstretch, stretch_2, stress\n1.5, -, 1\n", "a value of stretch_2, or"),
        (BIAXIAL + "1.5, 0, 1\n", "line 3: stretch_2 = 0.0: expected a number > 0"),
        (BIAXIAL + "1.5, 1.2, x\n", "line 3: stress_difference = 'x': expected a number"),
        (BIAXIAL + "1.5, 1.2\n", "line 3: no value of stress_difference"),
        (BIAXIAL + "1.2, 1.2, 0\n1.3, 1.3, 1\n", "expected different stretches"),
        (BIAXIAL.replace("stress_difference", "true_stress_2") + "2, 1, 1\n", "the nominal stre"),
        (BIAXIAL.replace("stress_difference", "cauchy stress 11") + "2, 1, 1\n", "the nominal"),
        (BIAXIAL + "1, 1.2, 1\n1.2, 2, 1\n", "the true stress of direction 1 minus that of 2"),
        (BIAXIAL.replace("biaxial", "planar") + "2, 1, 1\n", "in a test 'planar': expected stret"),
        (HEAD.replace("stress", "stress_2") + "2, 1\n", "'uniaxial': expected stretch or st"),
        ("# test = ps\nstretch, stress, stress_2\n2, 1, 1\n", "or test = biaxial, or --columns"),
        (BIAXIAL.replace("stretch", "strain_2, stretch", 1) + "2, 1, 0, 1\n", "stretch_2 or str"),
        ("lambda, lambda_2, stress, stress_2 [Pa]\n2, 1, 1, 1\n", "expected units of all, or of"),
        ("# weight = 0\n" + HEAD + "1.5, 1\n", "weight = '0': expected a number > 0"),
        ("# units = MPa\n" + HEAD + "1.5, 1\n", "line 1: '# units = MPa': unknown name (did you"),
        (
            "# unit = psi\n" + HEAD.replace("ss", "ss [MPa]") + "2, 1\n",
            "# unit = 'psi': expected that",
        ),
        (HEAD + "1.5, 1e-300\n", "line 3: stress = 1e-300: expected 0, or a number whose absolute"),
        (HEAD + "1.5, 1e308\n", "line 3: stress = 1e+308: expected 0, or a number whose absolute"),
        ("# weight = 1" + 400 * "0" + "\n" + HEAD + "2, 1\n", "weight = inf: expected a finite"),
        (BIAXIAL.replace("_dif", ", stres_dif") + "2, 1, 1, 1\n", "(did you mean 'stress_differ"),
    ],
)
def test_mistakes(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BadInput) as error:
        read(written(tmp_path, text))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_columns_that_are_no_data(tmp_path: Path) -> None:
    """Neither other columns nor comments are misspelt names."""
    text = "# rate: 1\n" + HEAD.replace("stress", "stress, stress_std, stress_3, strain_rate")
    (test,) = read(written(tmp_path, text + "1.5, 2, 3, 4, 5\n"))
    assert (test.x, test.stress) == (1.5, 2.0)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    written(tmp_path, HEAD)
    with pytest.raises(BadInput, match=r"no such file \(did you mean 'data.csv'\?\)"):
        read(tmp_path / "datas.csv")
    with pytest.raises(BadInput, match=r"no such file \(did you mean 'jones_treloar'\?\)"):
        read("jones-treloar")
    with pytest.raises(BadInput, match="Is a directory"):
        read(tmp_path)
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(BadInput, match="expected a text file"):
        read(tmp_path / "picture.png")


X = np.array([1.1, 1.2, 1.3])
PULL = TestData("pull", "uniaxial", X, X - 1, np.ones(3))
SQUEEZE = TestData("squeeze", "volumetric", 2 - X, 1 - X, np.ones(3))


@pytest.mark.parametrize(
    ("tests", "keywords", "message"),
    [
        ((), {}, "no test data"),
        ((PULL, SQUEEZE), {"incompressible": True}, "squeeze: a test 'volumetric' of an incompre"),
        ((PULL,), {"incompressible": True, "nu": 0.3}, "expected one of the two"),
        ((PULL,), {"incompressible": False}, "expected nu = a number below 0.5"),
        ((PULL,), {"nu": 0.6}, "nu = 0.6: expected a number from -1 to 0.5"),
        ((PULL,), {"parameters": ["gama"]}, "parameters = 'gama'"),
        ((PULL,), {"held": {"gama": 1}}, "has no parameter 'gama' (did you mean 'gamma'?)"),
        ((PULL,), {"bounds": {"gamma": (1, 0)}}, "the lowest value first"),
        ((PULL,), {"stable_range": (1.5, 2)}, "range = 1.5"),
        ((PULL,), {"weights": [1, 2]}, "expected one value, or one for each of 1 files"),
        ((PULL,), {"weights": [10**400]}, "weights = 1000000000"),
    ],
)  # fmt: skip
def test_mistakes_in_arguments(tests: tuple, keywords: dict, message: str) -> None:
    with pytest.raises(BadInput) as error:
        fem_snh.fit("stable_fung", *tests, **keywords)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("uniaxal", X, X), "t: kind = 'uniaxal': expected one of uniaxial"),
        (("biaxial", X, X, 1.0, X, "stres"), "(did you mean 'stress'?)"),
        (("uniaxial", X, X, 1.0, None, "stress_2"), "measure = 'stress_2': expected one of stress"),
        (("biaxial", X, X), "t: test 'biaxial': expected stretch_2"),
        (("planar", X, X, 1.0, 1.0), "t: test 'planar': expected no stretch_2"),
        (("uniaxial", X, X[:2]), "t: stress = array([1.1, 1.2]): expected one number, or one for"),
        (("uniaxial", ["a"], X), "t: x = ['a']: expected one number"),
    ],
)
def test_mistakes_in_test_data(arguments: tuple, message: str) -> None:
    kind, x, stress, *others = arguments
    with pytest.raises(BadInput) as error:
        TestData("t", kind, x, stress, *(others or [1.0]))
    assert message in str(error.value)


def test_one_number_for_all_points() -> None:
    test = TestData("t", "biaxial", X, X - 1, 2, 1.2)  # type: ignore[arg-type]
    assert np.array_equal(test.weight, [2, 2, 2])
    assert np.array_equal(test.stretch_2, [1.2, 1.2, 1.2])
    f = fem_snh.fit("neo_hookean", test)
    assert f.stress("biaxial", X, 1.2) == pytest.approx(f.tests[0].stress)
    assert f.stress("biaxial", X[0], 1.2) == pytest.approx(f.tests[0].stress[0])


def test_mistakes_in_stresses_of_a_fit() -> None:
    f = fem_snh.fit("neo_hookean", PULL)
    with pytest.raises(BadInput, match="did you mean 'uniaxial'"):
        f.stress("uniaxal", X)
    with pytest.raises(BadInput, match="measure = 'stress_2': expected one of stress"):
        f.stress("uniaxial", X, measure="stress_2")
    with pytest.raises(BadInput, match="expected stretch_2"):
        f.stress("biaxial", X)
    with pytest.raises(BadInput, match="test 'uniaxial': expected no stretch_2"):
        f.stress("uniaxial", X, X)
    with pytest.raises(BadInput, match=r"stretch_2 = .*: expected one number, or one for each x"):
        f.stress("biaxial", X, X[:2])


def test_too_few_points_and_too_far() -> None:
    with pytest.raises(BadInput, match="3 points for 6 unknowns"):
        fem_snh.fit("ogden", PULL)
    far = TestData("far", "uniaxial", X + 1, X, np.ones(3))
    with pytest.raises(BadInput, match="no fit has a stress at all measured stretches"):
        fem_snh.fit("stvk", far, nu=0.45)  # t^2 = 1 - nu (x^2 - 1) < 0
    with pytest.raises(BadInput, match="no fit has a stress at all measured stretches"):
        fem_snh.fit("gent", "treloar", nu=0.45)  # the best limit is that of the last point


def test_weights_of_files(tmp_path: Path) -> None:
    path = written(tmp_path, HEAD + "1.5, 1\n")
    assert [t.weight[0] for t in read_all([path, path], weights=[1, 5])] == [1, 5]


def test_units_that_a_file_states_twice(tmp_path):
    text = "# test = uniaxial\n# unit = N/mm²\nstretch, stress [MPa]\n1.5, 2\n"
    path = written(tmp_path, text)
    assert read(path)[0].stress == 2e6
    assert read(path, unit="psi")[0].stress == pytest.approx(2 * 6894.757, rel=1e-6)


def test_stresses_with_and_without_units_are_refused(tmp_path):
    path = written(tmp_path, HEAD + "1.5, 2\n")
    with pytest.raises(BadInput, match=r"^data: stresses without a unit beside those of treloar"):
        read_all([path, "treloar"])


def test_moduli_in_the_unit_of_a_scene(tmp_path):
    path = tmp_path / "pull.csv"
    path.write_text("# test = uniaxial\nstretch, stress [kPa]\n1.5, 500\n2, 900\n")
    (found,) = read(path, modulus_unit="MPa")
    assert found.stress == pytest.approx([0.5, 0.9])
    pascal, mega = (fem_snh.fit("neo_hookean", path, modulus_unit=u).E for u in (None, "N/mm²"))
    assert mega == pytest.approx(1e-6 * pascal)
    with pytest.raises(BadInput, match="modulus_unit = 'lb': expected one of Pa, "):
        read(path, modulus_unit="lb")
    path.write_text("# test = uniaxial\nstretch, stress\n1.5, 500\n2, 900\n")
    with pytest.raises(BadInput, match="modulus_unit = 'MPa': expected data whose stresses have"):
        read(path, modulus_unit="MPa")


STRAINS = np.array([20.0, 40.0, 70.0, 100.0, 200.0])
#: Nominal stresses of incompressible materials in tension, over the modulus.
RUBBERS = {
    "Neo-Hookean": lambda x: x - x**-2,
    "Mooney-Rivlin": lambda x: (x - x**-2) * (0.64 + 0.36 / x),
    "Ogden": lambda x: x**0.3 - x**-1.65,
    "Yeoh": lambda x: (x - x**-2) * (1 - 0.05 * (y := x**2 + 2 / x - 3) + 0.0025 * y**2),
}


@pytest.mark.parametrize("rubber", RUBBERS)
@pytest.mark.parametrize("column", ["stretch", "strain"])
def test_strains_in_per_cent_are_noticed(tmp_path, rubber, column):
    """In a column of stretches or of strains without a unit; with one they are read as such."""
    lines = [f"{x:g}, {RUBBERS[rubber](1 + x / 100)}" for x in STRAINS]
    text = f"# test = uniaxial\n{column}, stress\n" + "\n".join(lines)
    (found,) = read(written(tmp_path, text))
    largest = 200 + (column == "strain")
    assert found.note.startswith(f"{found.name}: stretches up to {largest:g}: if these are strains")
    (found,) = read(written(tmp_path, text.replace(column, "strain [%]", 1)))
    assert found.note == "" and found.x == pytest.approx(1 + STRAINS / 100)


@pytest.mark.parametrize("rubber", RUBBERS)
@pytest.mark.parametrize("largest", [1.2, 2.0, 3.0, 5.0, 7.5, 10.0])
def test_true_stretches_have_no_note(rubber, largest):
    x = np.linspace(1, largest, 12)[1:]
    for noise in (0.0, 0.03):
        stress = RUBBERS[rubber](x) * (1 + noise * np.cos(7 * np.arange(11)))
        assert TestData("t", "uniaxial", x, stress, np.ones(11)).note == ""


def test_built_in_data_have_no_note():
    assert [t.note for name in DATASETS for t in read(name) if t.note] == []


def test_a_test_that_is_not_described_has_a_note():
    """Treloar's rubber stiffens, and the planar test is a small part of the sum of squares."""
    poor = fem_snh.fit("neo_hookean", "treloar", incompressible=True)
    low = [t.data.name for t in poor.tests if t.r_squared < 0.8]
    assert low == ["treloar planar"]
    (note,) = poor.notes
    assert note.startswith("treloar planar: R² = 0.0") and "neo_hookean does not describe" in note
    assert fem_snh.fit("ogden", "treloar", incompressible=True).notes == []


def test_a_fit_has_the_notes_of_its_data(tmp_path, capsys):
    path = written(tmp_path, HEAD + "5, 0.05\n10, 0.1\n20, 0.19\n")
    note = "stretches up to 20: if these are strains in per cent, name the column 'strain [%]'"
    assert main(["fit", "neo_hookean", str(path), "--out", str(tmp_path / "fit")]) == 0
    assert f"note: {path.stem}: {note}" in capsys.readouterr().out.splitlines()
    record = json.loads((tmp_path / "fit" / "fit.json").read_text())
    assert record["notes"] == [f"{path.stem}: {note}"]
