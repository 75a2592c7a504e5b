"""Runs that are interrupted and resumed: the same result, on any number of ranks."""

from __future__ import annotations

import re

import numpy as np
import pytest
from features import CASES, every_feature
from interrupted_runs import ALL, ALONE, CutOff, cut, record, solve

from fem_snh import scenes
from fem_snh.runs import checkpoint as checkpoint_file
from fem_snh.runs import recorder
from fem_snh.runs.output import nodal_values
from fem_snh.runs.output.fields import Fields

mpi = pytest.mark.mpi


def difference(one, other):
    """The largest difference of any unknown between two checkpoints."""
    (_, a), (_, b) = checkpoint_file.load(one), checkpoint_file.load(other)
    gaps = []
    for name in ("u", "p"):
        if name in a:
            order = nodal_values.match_nodes(a[f"{name}_nodes"], b[f"{name}_nodes"])
            gaps.append(abs(a[name] - b[name][order]).max())
    return max(gaps)


def times(folder):
    return [
        float(t) for t in re.findall(r'timestep="([^"]+)"', (folder / "fields.pvd").read_text())
    ]


def contents(folder):
    """The content of all files of the series' states, by name."""
    return {file.name: file.read_bytes() for file in sorted(folder.glob("*vtu"))}


def case_of(name):
    """Return scene, options, and rows after which it is cut off, with fields of all kinds."""
    scene, options, steps = CASES[name]
    fields = ["reaction_force", "cauchy_stress"]
    scene = scenes.load(scene, **options)
    if scene.obstacle:
        fields += ["contact_pressure", "gap"]
    if scene.time:
        fields += ["velocity", "acceleration"]
    return scene, {"fields": fields}, steps


@mpi
@every_feature
def test_on_the_same_ranks_it_is_the_same_to_the_last_digit(comm, folder, case):
    """Rows, unknowns, velocity and acceleration, and every byte of the fields' files."""
    scene, options, steps = case_of(case)
    whole = solve(scene, out=folder / "whole", **options)
    with cut(steps):
        solve(scene, out=folder / "cut", **options)
    left = record(folder / "cut")
    assert len(left["steps"]) == steps and not left["converged"]
    again = solve(scene, out=folder / "cut", resume=True, **options)
    comm.barrier()
    found = record(folder / "cut")
    assert found["converged"] and again.converged
    accepted = [step["load"] for step in left["steps"] if step["converged"]]
    assert found["resumed"] == [accepted[-1] if accepted else 0.0]
    assert len(again.steps) == len(whole.steps)
    for one, other in zip(whole.steps, again.steps, strict=True):
        assert one | {"seconds": 0} == other | {"seconds": 0}
    assert np.array_equal(whole.problem.x.array, again.problem.x.array)
    if "time" in found:
        for name in ("v", "a"):
            one, other = (getattr(run, name).x.array for run in (whole, again))
            assert np.array_equal(one, other)
    assert times(folder / "cut") == times(folder / "whole")
    assert contents(folder / "cut") == contents(folder / "whole")
    comm.barrier()


@mpi
@pytest.mark.parametrize("case", ["two steps back", "bounce"])
def test_with_many_steps_the_record_may_wait(comm, folder, case, monkeypatch):
    """Only the first steps are written at once; the rest is lost with a crash, and nothing else."""
    scene, options, steps = case_of(case)
    whole = solve(scene, out=folder / "whole", **options)
    monkeypatch.setattr(recorder, "_FIRST_STEPS", 1)
    monkeypatch.setattr(recorder, "_SHARE", 1e-9)
    with cut(steps):
        solve(scene, out=folder / "cut", **options)
    assert len(times(folder / "cut")) == steps + 1
    (about, _), left = checkpoint_file.load(folder / "cut"), record(folder / "cut")
    assert len(about["record"]["steps"]) == 1 and len(left["steps"]) == steps
    again = solve(scene, out=folder / "cut", resume=True, **options)
    assert record(folder / "cut")["resumed"] == [left["steps"][0]["load"]]
    assert np.array_equal(whole.problem.x.array, again.problem.x.array)
    assert len(record(folder / "cut")["steps"]) == len(whole.steps)
    assert contents(folder / "cut") == contents(folder / "whole")
    comm.barrier()


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("case", ["extrapolate", "two steps back", "damped, turned", "bounce"])
def test_a_state_written_after_a_kill_is_the_same(comm, folder, case, monkeypatch):
    """A run that ends between checkpoint and fields: the resumed one writes the state first."""
    scene, options, steps = case_of(case)
    solve(scene, out=folder / "whole", **options)
    write, written = Fields.write, []

    def end_early(self, problem):
        if len(written) == steps:
            raise CutOff
        written.append(problem.load)
        write(self, problem)

    with cut(steps), monkeypatch.context() as patch:
        patch.setattr(Fields, "write", end_early)
        solve(scene, out=folder / "cut", **options)
    assert len(times(folder / "cut")) == steps
    solve(scene, out=folder / "cut", resume=True, **options)
    assert times(folder / "cut") == times(folder / "whole")
    assert contents(folder / "cut") == contents(folder / "whole")
    comm.barrier()


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("case", ["extrapolate", "pressure", "two steps back", "bounce"])
@pytest.mark.parametrize("before, after", [(ALONE, ALL), (ALL, ALONE)], ids=["1-all", "all-1"])
def test_on_another_number_of_ranks_it_is_the_same_to_the_solvers_tolerance(
    comm, folder, case, before, after
):
    scene, options, steps = CASES[case]
    # The kinetic energy is of first order in the solver's error.
    options = options | {"petsc": {"snes_scaled_tol": 1e-12}}
    solve(scene, out=folder / "whole", **options)
    with cut(steps):
        solve(scene, before, out=folder / "cut", **options)
    assert len(record(folder / "cut")["steps"]) == steps
    solve(scene, after, out=folder / "cut", resume=True, **options)
    found, whole = record(folder / "cut"), record(folder / "whole")
    assert found["converged"] and found["ranks"] == after.size
    key = "kinetic" if "time" in whole else "energy"  # in free fall the energy is 0
    energies = [[step[key] for step in each["steps"]] for each in (found, whole)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)
    assert difference(folder / "cut", folder / "whole") < 1e-8
    assert times(folder / "cut") == times(folder / "whole")
    comm.barrier()
