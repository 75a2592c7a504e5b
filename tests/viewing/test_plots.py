"""Graphs of runs and studies, and one-line messages for wrong input."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from picture_runs import bad, record, write_record

from fem_snh.errors import BadInput
from fem_snh.viewing import plots
from fem_snh.viewing.plots import sweeps
from fem_snh.viewing.plots.runs import curve_figure, run_figure, run_table

pytestmark = pytest.mark.one_debian

HEAD = "point,scene,material,nu,hessian,cells,converged,newton,linear,volume_ratio,seconds\n"
ROWS = """\
a,twist,stable_neo_hookean,0.3,clamp,5,True,10,100,1.02,1
b,twist,stable_neo_hookean,0.49,clamp,5,True,20,900,1.01,2
c,twist,neo_hookean,0.3,clamp,5,True,12,120,1.03,1
d,twist,neo_hookean,0.49,clamp,5,False,0,0,,2
e,twist,neo_hookean,0.5,clamp,5,False,0,0,,2
"""


def lines(figure: Any, panel: int) -> dict[str, Any]:
    return {line.get_label(): line for line in figure.axes[panel].lines}


def test_run_figure_shows_steps_and_failures():
    one = record((0.5, 1.0), scene="stretch", load_name="stretch", load_range=[1.0, 3.4])
    two = record((0.5, 1.0), scene="stretch", load_name="stretch", load_range=[1.0, 3.4])
    two["material"] = {"name": "fixed_corotational", "nu": 0.49}
    two["steps"][1] |= {"converged": False, "volume_ratio": None}
    figure = run_figure([one, two], newton=True)
    assert [ax.get_ylabel().split()[0] for ax in figure.axes] == ["volume", "linear", "Newton"]
    assert figure.axes[0].get_xlabel() == "stretch"
    volume = lines(figure, 0)
    assert np.allclose(volume["stable Neo-Hookean"].get_data(), [[1, 2.2, 3.4], [0, 2, 4]])
    assert np.allclose(volume["fixed corotational"].get_data(), [[1, 2.2], [0, 2]])
    assert np.allclose(lines(figure, 1)["stable Neo-Hookean"].get_data(), [[2.2, 3.4], [100, 200]])
    assert "not converged" in volume


def test_plot_runs(tmp_path):
    a, b = (write_record(tmp_path / name, record()) for name in "ab")
    assert plots.main([a]) == a / "history.png"
    assert plots.main([a, b]) == tmp_path / "comparison.png"
    out = plots.main([a], tmp_path / "new" / "x.pdf")
    assert out.read_bytes().startswith(b"%PDF")


def twisted(moments=(1.0, 3.0)):
    """A run with a torque, half of it a force, over an angle of 2."""
    run = record((0.5, 1.0), scene="turn", load_name="angle", load_range=[0.0, 2.0])
    for step, moment in zip(run["steps"], moments, strict=True):
        step["moments"] = {"inner": [0.1, 0.0, moment]}
        step["reactions"] = {"inner": [moment / 2, 0.0, 0.0]}
    return run


def test_the_torque_is_a_panel_of_the_default_picture():
    figure = run_figure([twisted(), twisted((2.0, 5.0))])
    assert figure.axes[2].get_ylabel() == "inner.moment.z"
    found = [list(map(float, line.get_ydata())) for line in figure.axes[2].lines]
    assert [1.0, 3.0] in found and [2.0, 5.0] in found


def test_curves_of_columns(tmp_path):
    """A column over the load by its name, a quotient, and another column."""
    table = run_table(twisted())
    figure = curve_figure({"turn": table}, "angle", ["inner.moment.z", "inner.moment.z/angle"])
    (line,), (slope,) = (ax.lines for ax in figure.axes)
    assert line.get_xdata().tolist() == [1.0, 2.0] and line.get_ydata().tolist() == [1.0, 3.0]
    assert slope.get_ydata().tolist() == [1.0, 1.5]
    write_record(tmp_path, twisted())
    assert plots.main([tmp_path], y=["inner.force.x"]) == tmp_path / "curves.png"
    assert (tmp_path / "curves.png").stat().st_size > 1000
    with pytest.raises(BadInput, match=r"column = 'iner.moment.z': .*'inner.moment.z'"):
        plots.main([tmp_path], y=["iner.moment.z"])
    with pytest.raises(BadInput, match="--x angle: expected with --y"):
        plots.main([tmp_path], x="angle")


def test_stiffness_over_nu_in_a_sweep(tmp_path):
    """A line for each material, in the order of nu; points that failed are left out."""
    rows = [("b", 0.49, True, 8.0), ("a", 0.3, True, 6.0), ("c", 0.4999, False, 1.0)]
    text = "point,material,nu,converged,newton,linear,volume_ratio,seconds,top.force.z,top.z\n"
    text += "".join(f"{p},snh,{nu},{ok},1,1,1,1,{force},2\n" for p, nu, ok, force in rows)
    (tmp_path / "sweep.csv").write_text(text)
    table = sweeps.read_table(tmp_path / "sweep.csv")
    figure = curve_figure(sweeps.by_material(table, "nu"), "nu", ["top.force.z/top.z"])
    (line,) = figure.axes[0].lines
    assert line.get_xdata().tolist() == [0.3, 0.49] and line.get_ydata().tolist() == [3.0, 4.0]
    assert plots.main([tmp_path], x="nu", y=["top.force.z"]) == tmp_path / "curves.png"
    with pytest.raises(BadInput, match="--y: expected with --x"):
        plots.main([tmp_path], y=["top.force.z"])


ERRORS = """\
point,material,nu,element,cells,globalization,converged,seconds,error,tip.x,tip.x.error
a,snh,0.3,Q1,4,trust_region,True,1,0.4,2,-0.8
b,snh,0.3,Q1,8,trust_region,True,8,0.1,2,-0.2
c,snh,0.3,Q2Q1,2,linesearch,True,2,0.05,2,0.1
d,snh,0.3,Q2Q1,4,linesearch,True,9,0.001,2,0.002
e,snh,0.3,Q2Q1,8,linesearch,False,0.1,,,
f,snh,0.3,Q2Q1,16,linesearch,True,0.1,,2,
"""


def test_errors_over_cost_mark_the_pareto_front(tmp_path):
    """Q1 on 8 cells is slower than Q2Q1 on 2 and less accurate; e failed, f has no estimate."""
    file = tmp_path / "sweep.csv"
    file.write_text(ERRORS)
    figure = sweeps.front_figure(sweeps.read_table(file), "seconds", "error", file)
    shown = lines(figure, 0)
    assert list(shown)[:2] == ["snh, Q1", "snh, Q2Q1"]  # without the default globalization
    (best,) = [line for label, line in shown.items() if label.startswith("best")]
    assert best.get_xdata().tolist() == [1, 2, 9]
    assert best.get_ydata().tolist() == [0.4, 0.05, 0.001]
    assert [text.get_text() for text in figure.axes[0].texts] == ["Q1, 4", "Q2Q1, 2", "Q2Q1, 4"]
    of_one = sweeps.front_figure(sweeps.read_table(file), "seconds", "tip.x.error/tip.x", file)
    assert lines(of_one, 0)["snh, Q1"].get_ydata().tolist() == [0.4, 0.1]
    assert plots.main([tmp_path], x="seconds", y=["error"]) == tmp_path / "curves.png"


def test_plot_sweep(tmp_path):
    table = tmp_path / "sweep.csv"
    table.write_text(HEAD + ROWS)
    assert plots.main([table]) == plots.main([tmp_path]) == tmp_path / "sweep.png"
    figure = sweeps.sweep_figure(sweeps.read_sweep(table))
    assert len(figure.axes) == 4
    shown = lines(figure, 0)
    assert np.allclose(shown["stable Neo-Hookean"].get_data(), [[0.2, 0.01], [10, 20]])
    assert "not converged" in shown
    left, right = figure.axes[0].get_xlim()
    assert left > right
    assert [t.get_text() for t in figure.axes[0].get_xticklabels()] == ["0.3", "0.49"]


def test_plot_bad_arguments(tmp_path):
    run = write_record(tmp_path / "a", record())
    assert "nothing to plot" in bad(plots.main, [])
    assert "no such file" in bad(plots.main, [tmp_path / "x.csv"])
    assert "one table" in bad(plots.main, [run, tmp_path / "x.csv"])
    assert "cannot be written" in bad(plots.main, [run], run / "a.xyz")
    assert "cannot write" in bad(plots.main, [run], run / "run.json" / "a.png")
    assert "no step yet" in bad(plots.main, [write_record(tmp_path / "b", record(()))])
    broken = record()
    del broken["steps"][0]["linear"]
    del broken["steps"][1]["linear"]
    assert "linear" in bad(plots.main, [write_record(tmp_path / "c", broken)])


def test_pictures_do_not_need_the_solver():
    code = "import fem_snh.viewing.plots, fem_snh.viewing.render, sys; print(*sys.modules)"
    output = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert not {"dolfinx", "petsc4py", "mpi4py", "gmsh", "pyvista"} & set(output.split())
