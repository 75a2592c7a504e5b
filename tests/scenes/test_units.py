"""Units of a scene: what is accepted, and the labels of pictures, plots and pages."""

from __future__ import annotations

import pytest
from picture_runs import bad, record
from running import record as recorded
from running import solve

from fem_snh.cli import main
from fem_snh.records.units import Units
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
