"""Units of a scene: what is accepted, and the labels of pictures, plots and pages."""

from __future__ import annotations

import pytest
from picture_runs import bad, record, write_record
from running import record as recorded
from running import solve

from fem_snh import scenes
from fem_snh.cli import main
from fem_snh.errors import BadInput
from fem_snh.records.run_record import column_unit, results
from fem_snh.records.units import Units, volume_change
from fem_snh.viewing import page, plots, render
from fem_snh.viewing.plots.runs import curve_figure, draw_energies, list_columns, run_table
from fem_snh.viewing.stored_run import axis_label, column_label, label

MM = Units("mm", "N", "MPa")


def test_units_are_read_in_any_order():
    assert Units.read("mm, N, MPa") == Units.read(" MPa ,N,mm") == MM
    assert Units.read("N,mm,N/mm²") == Units("mm", "N", "N/mm^2")
    assert Units.read("in, lbf, psi") == Units("in", "lbf", "psi")
    assert Units.read("mm, kN, GPa, ms") == Units("mm", "kN", "GPa", "ms")
    assert Units.read("m,N,Pa") == Units()


@pytest.mark.parametrize(
    "text, message",
    [
        ("mm, N, Pa", "expected N over mm squared as the unit of stress: MPa or N/mm^2"),
        ("mm, kgf, MPa", "expected kgf over mm squared as the unit of stress: 9.80665e+06 Pa, "),
        ("mm, N", 'expected a unit of stress too, as "mm, N, MPa"'),
        ("mm", 'expected a unit of force and of stress too, as "mm, N, MPa"'),
        ("mm, cm, N, MPa", "expected one unit of length, not mm and cm"),
        ("mm, N, Mpa", "expected units, not 'Mpa': of length m, dm, "),
        ("", "expected units, not '': of length m, "),
        (3, 'expected units of length, force and stress, "mm, N, MPa"'),
    ],
)
def test_wrong_units_are_one_line(text, message):
    with pytest.raises(BadInput) as caught:
        scenes.load("twist", units=text)
    assert str(caught.value).startswith(f"twist: units = {text!r}: {message}")
    assert "\n" not in str(caught.value)


def test_names_of_derived_units():
    assert [MM.name(u) for u in ("N m", "J", "m/s^2", "Pa/m", "m^3", "kg m/s", "rad", "")] == [
        "N mm", "N mm", "mm/s^2", "MPa/mm", "mm^3", "N s", "rad", ""
    ]  # fmt: skip
    assert [Units().name(u) for u in ("J", "kg m/s", "Pa")] == ["J", "kg m/s", "Pa"]
    flat = Units("mm", "N", "MPa", in_plane=True)
    assert [flat.name(u) for u in ("N", "N m", "J", "m", "Pa", "m^3", "kg m/s")] == [
        "N/mm", "N", "N", "mm", "MPa", "mm^2", "N s/mm"
    ]  # fmt: skip
    about = record(units="mm, N, MPa", kinematics="plane_strain")
    assert Units.of(about) == flat
    assert Units.of(record(units="mm, N, MPa", kinematics="axisymmetric")) == MM
    assert Units.of(record()) is None
    assert bad(Units.of, record(units="mm")).startswith("run.json: units = 'mm': expected ")


#: A step with every kind of column.
STEP = {
    "load": 1.0, "energy": 2.0, "max_u": 0.1, "volume_ratio": 1.0, "newton": 3, "seconds": 1.0,
    "reactions": {"top": [0, 0, 1]}, "moments": {"top": [0, 0, 2]}, "probes": {"edge": [1, 2, 3]},
    "volumes": {"body": 1.0}, "cavities": {"inner": {"volume": 1.0, "pressure": 2.0}},
    "obstacles": {"ball": {"force": [1, 2, 3], "penetration": 0.1, "stiffness": 3.0}},
    "rigid": {"bar": {"displacement": [1, 2, 3], "rotation": [0, 0, 1]}}, "momentum": [1, 2, 3],
    "goals": {"top.mean.z": 1.0}, "errors": {"edge.y": 0.1, "top.moment.z": 0.2},
}  # fmt: skip
UNITS = {
    "energy": "J", "max_u": "m", "volume_ratio": "", "newton": "", "seconds": "", "load": "",
    "top.force.z": "N", "top.moment.z": "N m", "edge.x": "m", "body.volume": "",
    "inner.volume": "m^3", "inner.pressure": "Pa", "ball.force.y": "N", "ball.penetration": "m",
    "ball.stiffness": "Pa/m", "bar.displacement.x": "m", "bar.rotation.z": "rad",
    "momentum.x": "kg m/s", "top.mean.z": "m", "edge.y.error": "m", "top.moment.z.error": "N m",
    "top.force.z/edge.x": "N/m", "edge.x/edge.y": "", "body.volume/edge.x": "1/m",
    "top.force.z/top.moment.z": "N/(N m)", "edge.x/body.volume": "m",
}  # fmt: skip


@pytest.mark.parametrize("name", UNITS)
def test_units_of_columns(name):
    assert column_unit(name, STEP) == UNITS[name]
    assert set(UNITS) > set(results({"probes": STEP["probes"]})) - {"edge.y", "edge.z"}


def test_labels():
    assert label("cauchy_stress.xy", MM) == "Cauchy stress, xy [MPa]"
    assert label("von_mises") == "von Mises stress [Pa]"
    assert label("displacement", MM) == "|u|  (displacement) [mm]"
    stated = record(units="mm, N, MPa", time={"duration": 1.0})
    stated["steps"][0] |= {"reactions": {"top": [0, 0, 1]}}
    assert column_label("top.force.z", [stated]) == "top.force.z [N]"
    assert column_label("top.force.z", [stated, record()]) == "top.force.z"
    assert axis_label(stated) == "time [s]"
    assert axis_label(stated | {"units": "mm, kN, GPa, ms"}) == "time [ms]"
    _, (ax,) = plots.style.subplots(1)
    stated["steps"] = [s | {"time": s["load"], "energy": 1.0} for s in stated["steps"]]
    draw_energies(ax, [stated | {"time": {"duration": 1.0, "start": {}}}], ["a"])
    assert ax.get_ylabel() == "energy [N mm]"


def test_a_run_names_its_units_in_plots_pictures_and_pages(folder):
    """Its numbers are those of the scene without units; the picture has a scale bar."""
    solve("twist", cells=2, steps=2, angle=0.4, units="mm, N, MPa", out=folder / "mm")
    solve("twist", cells=2, steps=2, angle=0.4, out=folder / "si")
    mm, si = recorded(folder / "mm"), recorded(folder / "si")
    assert mm["units"] == "mm, N, MPa" and "units" not in si
    assert mm["steps"][-1]["energy"] == si["steps"][-1]["energy"]
    tables = {"twist": run_table(mm)}
    figure = curve_figure(tables, "edge.x", ["top.force.z"], lambda n: column_label(n, [mm]))
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == (
        "edge.x [mm]", "top.force.z [N]"
    )  # fmt: skip
    lines = {line.split()[0]: line.split()[1:] for line in list_columns(folder / "mm")}
    assert lines["angle"] == ["0.4"] and lines["newton"] == [str(mm["steps"][-1]["newton"])]
    assert lines["edge.x"][1:] == ["mm"] and lines["top.force.z"][1:] == ["N"]
    assert "reason" not in lines
    assert main(["plot", str(folder / "si"), "--columns"]) == 0
    assert plots.main([folder / "mm"], y=["top.force.z", "energy"]).is_file()
    assert "<th>energy [N mm]</th>" in page._step_table(mm)
    assert "<th>energy</th>" in page._step_table(si)
    pictures = [render.main(folder / name, field="displacement") for name in ("mm", "si")]
    image = pytest.importorskip("matplotlib.image").imread
    with_units, without = map(image, pictures)
    footer = slice(-render_foot(), None)
    changed = abs(with_units - without).max(axis=2) > 0.3
    assert changed[footer, :400].sum() > 100 and not changed[: -render_foot()].any()


def render_foot() -> int:
    from fem_snh.viewing.render.drawing import FOOT

    return FOOT


def test_a_damaged_record_is_one_line(folder):
    write_record(folder, record(units="ells"))
    assert bad(plots.main, [folder], None, False, None, ["min_J"]).startswith("run.json: units = ")
    write_record(folder, record(units=3))
    assert "units = 3: expected a text" in bad(plots.main, [folder])


def test_a_volume_that_hardly_changes_has_no_sign():
    changes = [volume_change(1 + part) for part in (-4e-5, 0.0, 4e-5, -6e-5, 0.0051)]
    assert changes == ["0.00", "0.00", "0.00", "-0.01", "+0.51"]
