"""Meshes of built-in sources in the cache: as gmsh's, and generated again if damaged."""

from __future__ import annotations

import numpy as np
import pytest

from fem_snh.mesh import gmsh_input, gmsh_model

CUBE = gmsh_input.source_path("cube")


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """An empty cache."""
    monkeypatch.setenv("FEM_SNH_CACHE", str(tmp_path))
    return tmp_path


@pytest.fixture
def generated(folder, monkeypatch):
    """A list of the parameters with which gmsh has generated a mesh."""
    parameters = []
    generate = gmsh_model.generate

    def counted(*arguments):
        parameters.append(arguments[2])
        return generate(*arguments)

    monkeypatch.setattr(gmsh_model, "generate", counted)
    return parameters


def assert_same(a: gmsh_model.MeshData, b: gmsh_model.MeshData) -> None:
    """Assert that two meshes have the same numbering, coordinates to the last bit and groups."""
    assert (a.cell, a.degree) == (b.cell, b.degree)
    assert [group[:3] for group in a.groups] == [group[:3] for group in b.groups]
    pairs = [(a.cells, b.cells), (a.x, b.x)]
    pairs += [(g.entities, h.entities) for g, h in zip(a.groups, b.groups, strict=True)]
    for one, other in pairs:
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    "source, cell, parameters",
    [
        ("cube", "hexahedron", {"cells": 3}),
        ("cube", "tetrahedron", {"cells": 2}),
        ("cook", "quadrilateral", {"cells": 4}),
        ("cylinder", "hexahedron", {"cells": 4, "length": 2.0, "order": 2}),
        ("ball", "tetrahedron", {"cells": 3, "order": 2}),
    ],
)
def test_a_stored_mesh_is_the_generated_one(generated, source, cell, parameters):
    path = gmsh_input.source_path(source)
    first = gmsh_input.generate(path, cell, parameters)
    again = gmsh_input.generate(path, cell, parameters)
    assert len(generated) == 1
    assert_same(first, again)


def test_other_arguments_give_another_mesh(generated):
    for cell in ("hexahedron", "tetrahedron"):
        for cells in (1, 2):
            data = gmsh_input.generate(CUBE, cell, {"cells": cells})
            assert data.cell == cell and len(data.x) == (cells + 1) ** 3
    assert len(generated) == 4


def test_a_changed_source_is_meshed_again(generated, tmp_path):
    path = tmp_path / "cube.geo"
    path.write_text(CUBE.read_text())
    gmsh_input.generate(path, "hexahedron", {"cells": 1})
    path.write_text(CUBE.read_text().replace("Extrude {0, 0, 1}", "Extrude {0, 0, 2}"))
    assert gmsh_input.generate(path, "hexahedron", {"cells": 1}).x.max() == 2
    assert len(generated) == 2


def test_a_damaged_file_is_replaced(generated, folder):
    first = gmsh_input.generate(CUBE, "hexahedron", {"cells": 1})
    (file,) = folder.glob("*.mesh")
    file.write_bytes(file.read_bytes()[:-100])
    assert_same(gmsh_input.generate(CUBE, "hexahedron", {"cells": 1}), first)
    assert_same(gmsh_input.generate(CUBE, "hexahedron", {"cells": 1}), first)
    assert len(generated) == 2


def test_large_meshes_and_old_ones_are_not_kept(generated, folder, monkeypatch):
    monkeypatch.setattr(gmsh_input, "_LARGEST_STORED", 8 * 3**3)
    monkeypatch.setattr(gmsh_input, "_MOST_STORED", 2)
    for cells in (1, 2, 3, 4):
        gmsh_input.generate(CUBE, "hexahedron", {"cells": cells})
    assert len(list(folder.glob("*.mesh"))) == 2
    for cells in (2, 3):
        gmsh_input.generate(CUBE, "hexahedron", {"cells": cells})
    assert [parameters["cells"] for parameters in generated] == [1, 2, 3, 4]


def test_errors_are_not_kept(folder):
    for _ in range(2):
        with pytest.raises(Exception, match="expected a whole number"):
            gmsh_input.generate(CUBE, "hexahedron", {"cells": 1.5})
    assert not list(folder.glob("*.mesh"))
