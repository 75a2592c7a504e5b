"""Graphs, labels and choices of states of runs in time: seconds instead of loads."""

from __future__ import annotations

from typing import Any

import pytest

from fem_snh.viewing.plots.runs import run_figure
from fem_snh.viewing.stored_run import axis_label, load_range, panel_label, parameter, step_at

START = {"energy": 0.0, "kinetic": 0.0, "elastic": 0.0, "potential": 0.0, "dissipated": 0.0}


def record(duration: float = 1e-3, **about: Any) -> dict[str, Any]:
    """Return the run.json of a fall in four steps; three fail first."""
    steps = []
    for k in (1, 1, 2, 3, 4):
        t = duration * k / 4
        energies = {"kinetic": t**2, "elastic": 0.0, "potential": -(t**2), "energy": 0.0}
        row = {"load": k / 4, "time": t, "converged": len(steps) > 0, **energies}
        steps.append(row | {"volume_ratio": 1.0, "min_J": 0.9, "linear": 3, "newton": 2})
    material = {"name": "stable_neo_hookean", "nu": 0.4}
    time = {"duration": duration, "steps": 4, "start": START}
    return {"scene": "fall", "material": material, "time": time, "steps": steps} | about


def test_states_are_named_by_their_time() -> None:
    run = record()
    assert panel_label(run, 5e-4).startswith("time 0.0005 s  ·  volume 0.00 %")
    assert parameter(run, 5e-4) == 5e-4 and load_range(run) == (0.0, 1e-3)
    assert axis_label(run) == "time [s]"
    step = step_at(run, 2.5e-4)
    assert step is not None and step["converged"] and step["load"] == 0.25
    assert step_at(run, 3e-4) is None
    quasi_static = {key: v for key, v in run.items() if key != "time"}
    assert panel_label(quasi_static, 0.5).startswith("load 0.5  ·")


def test_a_graph_of_one_run_has_its_energies() -> None:
    figure = run_figure([record()])
    *_, energies = figure.axes
    assert energies.get_xlabel() == "time [s]" and energies.get_ylabel() == "energy [J]"
    lines = {line.get_label(): line.get_ydata()[-1] for line in energies.get_lines()}
    assert lines == pytest.approx({"kinetic": 1e-6, "potential": -1e-6})
    first = figure.axes[0].get_lines()[0].get_xdata()
    assert list(first) == pytest.approx([0, 2.5e-4, 5e-4, 7.5e-4, 1e-3])


def test_a_graph_of_several_runs_has_their_sums() -> None:
    figure = run_figure([record(), record(element="Q1")])
    assert figure.axes[-1].get_ylabel().startswith("kinetic + elastic + potential")
    assert [len(line.get_xdata()) for line in figure.axes[-1].get_lines()] == [5, 5]
    mixed = run_figure([record(), {k: v for k, v in record().items() if k != "time"}])
    assert len(mixed.axes) == 2 and mixed.axes[0].get_xlabel() == "time [s], load"
