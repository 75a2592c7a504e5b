"""Files of test data: units, names of columns, tests, and one line for everything that is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fem_snh
from fem_snh.errors import BadInput
from fem_snh.studies.fit import TestData
from fem_snh.studies.fit.data import read


def written(folder: Path, text: str) -> Path:
    path = folder / "data.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "kind", "x", "stress"),
    [
        ("# test = uniaxial\nstretch, stress [MPa]\n1.5, 0.2\n", "uniaxial", 1.5, 2e5),
        ("# Test = planar\nstretch;Stress (N/mm²)\n2;0.3\n", "planar", 2.0, 3e5),
        ("# test = equibiaxial\nstrain [%]\tstress [kPa]\n50\t2\n", "equibiaxial", 1.5, 2e3),
        ("# test = simple_shear\nshear stress\n0.4 0.1\n", "simple_shear", 0.4, 0.1),
        ("# test=uniaxial\nstrain, stress [kgf/cm2], time\n0.5, 2, 7\n", "uniaxial", 1.5, 196133.0),
        ("# test = confined\nstretch, pressure\n0.9, 2\n", "confined", 0.9, -2.0),
        ("test, stretch, stress\nuniaxial, 0.5, -1\n", "uniaxial", 0.5, -1.0),
        ("# test = uniaxial\nstretch, stress [psi]\n1.5, 1\n", "uniaxial", 1.5, 6894.757293168361),
        ('"test", stretch, stress\n"uniaxial", 1.1, .05\n', "uniaxial", 1.1, 0.05),
    ],
)  # fmt: skip
def test_files(tmp_path: Path, text: str, kind: str, x: float, stress: float) -> None:
    (found,) = read(written(tmp_path, text))
    assert found.kind == kind
    assert found.x == pytest.approx([x], rel=1e-15)
    assert found.stress == pytest.approx([stress], rel=1e-12)


def test_pressure_over_volume(tmp_path: Path) -> None:
    """P = -p J^(2/3): the nominal stress on the faces of a cube of side J^(1/3)."""
    (found,) = read(
        written(tmp_path, "# test = volumetric\nvolume_ratio, pressure [MPa]\n0.729, 10\n")
    )
    assert found.kind == "volumetric"
    assert found.x == pytest.approx([0.9], rel=1e-14)
    assert found.stress == pytest.approx([-10e6 * 0.81], rel=1e-14)


def test_biaxial_tests(tmp_path: Path) -> None:
    """Two nominal stresses are two tests; a cell without a value is empty or a dash."""
    head = "# test = biaxial\nstrain [%], stretch_2, stress [kPa], stress_2 [MPa]\n"
    text = head + "50,1.2,30,0.02\n60,1,-,.01\n,,\n"
    with pytest.raises(BadInput, match="line 5: no value of strain"):
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


def test_options_replace_what_a_file_states(tmp_path: Path) -> None:
    path = written(tmp_path, "# test = uniaxial\nstretch, stress [MPa]\n1.5, 0.2\n")
    (found,) = read(path, test="planar", columns=["stress", "strain"], unit="Pa", weight=3)
    assert (found.kind, found.x[0], found.stress[0], found.weight[0]) == ("planar", 1.2, 1.5, 3)


def test_a_column_of_tests_and_of_weights(tmp_path: Path) -> None:
    rows = "uniaxial, 1.5, 1, 2\nplanar, 1.2, .5, 1\nuniaxial, 2, 2, 4\n"
    text = f"test, stretch, stress, weight\n{rows}"
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
        ("# test = uniaxial\nstretch, stress [lb]\n1.5, 2\n", "unit = 'lb': expected one of Pa"),
        ("# test = uniaxial\nstretch [mm], stress\n1.5, 2\n", "unit of stretch = 'mm'"),
        (HEAD, "no line of numbers"),
        (HEAD + "1.5\n", "line 3: no value of stress"),
        (HEAD + "1,5, 0,3\n2,1, 0,5\n", "line 3: 4 values for 2 columns: expected one for"),
        ("# test = uniaxial\nstrain, stress\n1.1, n/a\n2, 1\n", "line 3: stress = 'n/a': "),
        (HEAD.replace("stretch", "strain [%]") + "-120, 1\n", "= -120.0: expected a number > -"),
        (HEAD.replace("stress", "stress, weight") + "2, 1, -3\n", "weight = '-3': expected"),
        (HEAD + "0, 1\n", "line 3: stretch = 0.0: expected a number > 0"),
        (HEAD + "1, 0\n", "expected a deformation and a stress other than 0"),
        (HEAD + "0.5, 1\n0.4, 2\n", "every stress has the wrong sign"),
        ("# test = simple_shear\nstretch, stress\n1, 1\n", "expected shear or strain or stress"),
        ("# test = biaxial\nstretch, stress\n1.5, 1\n", "test 'biaxial': expected stretch_2"),
        ("# test = biaxial\nstretch, stretch_2, stress\n1.5, -, 1\n2, 2, 1\n",
         "line 3: stretch_2 = nan: expected a number"),
        (BIAXIAL + "1.2, 1.2, 0\n1.3, 1.3, 1\n", "expected different stretches"),
        (BIAXIAL + "1, 1.2, 1\n1.2, 2, 1\n", "the true stress of direction 1 minus that of 2"),
        (BIAXIAL.replace("biaxial", "planar") + "2, 1, 1\n", "in a test 'planar': expected stret"),
        (BIAXIAL.replace("stretch", "strain_2, stretch", 1) + "2, 1, 0, 1\n", "stretch_2 or str"),
        (BIAXIAL.replace("_difference", ", stress_2 [Pa]") + "2, 1, 1, 1\n",
         "expected units of all, or of"),
        (HEAD + "1.5, 1e-300\n",
         "line 3: stress = '1e-300': expected 0, or a number whose absolute"),
    ],
)  # fmt: skip
def test_mistakes(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BadInput) as error:
        read(written(tmp_path, text))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


X = np.array([1.1, 1.2, 1.3])


def test_one_number_for_all_points() -> None:
    test = TestData("t", "biaxial", X, X - 1, 2, 1.2)  # type: ignore[arg-type]
    assert np.array_equal(test.weight, [2, 2, 2])
    assert np.array_equal(test.stretch_2, [1.2, 1.2, 1.2])
    f = fem_snh.fit("neo_hookean", test)
    assert f.stress("biaxial", X, 1.2) == pytest.approx(f.tests[0].stress)
    assert f.stress("biaxial", X[0], 1.2) == pytest.approx(f.tests[0].stress[0])


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
    with pytest.raises(BadInput, match="expected units of all, or of none and no modulus_unit"):
        read(path, modulus_unit="MPa")


@pytest.mark.parametrize("column", ["stretch", "strain"])
def test_strains_in_per_cent_are_refused(tmp_path, column):
    """In a column of stretches or of strains without a unit; with one they are read as such."""
    text = f"# test = uniaxial\n{column}, stress\n" + "20, 1\n200, 2\n"
    with pytest.raises(BadInput, match=rf"line 3: {column} = 20.0: .*, or a column 'strain \[%\]'"):
        read(written(tmp_path, text))
    (found,) = read(written(tmp_path, text.replace(column, "strain [%]", 1)))
    assert found.x == pytest.approx([1.2, 3])


def test_a_test_that_is_not_described_has_a_note():
    """Treloar's rubber stiffens, and the planar test is a small part of the sum of squares."""
    poor = fem_snh.fit("neo_hookean", "treloar")
    low = [t.data.name for t in poor.tests if t.r_squared < 0.8]
    assert low == ["treloar planar"]
    (note,) = poor.notes
    assert note.startswith("treloar planar: R² = 0.0") and "neo_hookean does not describe" in note
    assert fem_snh.fit("ogden", "treloar").notes == []
