"""Pictures of the fields that a run has written: names, components, labels, mistakes."""

from __future__ import annotations

import numpy as np
import pytest
from picture_runs import bad
from running import solve

from fem_snh.viewing import render
from fem_snh.viewing.render import surfaces
from fem_snh.viewing.stored_run import written_fields


@pytest.fixture(scope="module")
def stressed(tmp_path_factory):
    """A run with some fields at cells and at nodes."""
    folder = tmp_path_factory.mktemp("run")
    names = ["von_mises", "cauchy_stress", "principal_stresses", "reaction_force"]
    solve("twist", cells=2, steps=1, angle=0.8, fields=names, out=folder)
    return folder


def values(folder, field):
    files = [str(f) for f in render.stored_loads(folder / "fields.pvd")[1.0]]
    return surfaces.read_grid(files, field)[field], surfaces.body(files, field).values


def test_the_fields_of_a_run_are_those_of_its_files(stressed):
    assert written_fields(stressed / "fields.pvd") == [
        "J", "cauchy_stress", "displacement", "energy_density", "min_J", "min_eigenvalue",
        "principal_stresses", "reaction_force", "von_mises",
    ]  # fmt: skip


def test_components_and_magnitudes_are_drawn(stressed):
    tensor, magnitude = values(stressed, "cauchy_stress")
    xy, _ = values(stressed, "cauchy_stress.xy")
    assert tensor.shape == (8, 9) and (xy == tensor[:, 1]).all()
    frobenius = np.sqrt((tensor**2).sum(axis=1))
    assert set(magnitude.round(12)) <= set(frobenius.round(12))
    largest, _ = values(stressed, "principal_stresses.1")
    smallest, _ = values(stressed, "principal_stresses.3")
    assert (largest > smallest).all()
    up, drawn = values(stressed, "displacement.z")
    assert len(up) == 27 and drawn.min() >= up.min() - 1e-12
    force, _ = values(stressed, "reaction_force.x")
    assert abs(force).max() > 0.01


def test_mistakes(stressed):
    def error_message(field):
        return bad(render.main, stressed, None, None, field)

    for field in ("von_mses", "pk1_stress", "pk1_stress.xy"):
        message = error_message(field)
        assert message.startswith(f"field = '{field}': expected one of J, cauchy_stress, ")
    assert "did you mean 'von_mises'" in error_message("von_mses")
    assert "a run with --set fields=pk1_stress writes it" in error_message("pk1_stress.xy")
    assert error_message("cauchy_stress.q") == (
        "field = 'cauchy_stress.q': expected a component of cauchy_stress: "
        "xx, xy, xz, yx, yy, yz, zx, zy, zz"
    )
    assert error_message("von_mises.x") == "field = 'von_mises.x': expected 'von_mises', a scalar"
