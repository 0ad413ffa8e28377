"""A mesh that left gmsh comes back the same, and VTK understands it."""

import csv

import gmsh
import meshio
import numpy as np
import pytest
import pyvista
import vtk

from bristle.meshes.check import meshed_volume_m3, read_cells, volume_m3
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.hexahedra import build_model, gmsh_model
from bristle.meshes.section import Circle, Rectangle
from bristle.studies.mesh.picture import TAG_DATA, write_vtu
from bristle.studies.mesh.run import measure_quality, write_csv

SPECS = [
    MeshSpec(0.02, section, (2, 3, 4), order, 3.0)
    for section in (Rectangle(0.5e-3, 2.08e-3), Circle(1.2e-3))
    for order in (1, 2)
]
EVERY_SPEC = pytest.mark.parametrize(
    "spec", SPECS, ids=lambda s: f"{type(s.section).__name__}-{s.geometry_order}"
)


@pytest.fixture
def files(spec, tmp_path):
    """Return the paths of the .msh and the .vtu file of a spec."""
    msh, vtu = tmp_path / "bristle.msh", tmp_path / "bristle.vtu"
    with gmsh_model():
        build_model(spec)
        gmsh.write(str(msh))
    write_vtu(msh, vtu)
    return msh, vtu


def vtk_cells(path, cell_class):
    """Return the cells of a class as VTK reads them, a list of (n, 3) points, and the cells."""
    grid = pyvista.read(path)
    cells = []
    for index in range(grid.n_cells):
        if grid.GetCellType(index) == cell_class().GetCellType():
            cell = cell_class()
            cell.DeepCopy(grid.GetCell(index))
            cells.append(cell)
    return cells


def vtk_class(spec):
    return {1: vtk.vtkHexahedron, 2: vtk.vtkTriQuadraticHexahedron}[spec.geometry_order]


def blocks(mesh, data):
    """Cells and their ``data`` by the cells' type."""
    found = {}
    for block, values in zip(mesh.cells, mesh.cell_data[data], strict=True):
        cells, own = found.get(block.type, (block.data[:0], values[:0]))
        found[block.type] = np.concatenate([cells, block.data]), np.concatenate([own, values])
    return found


@EVERY_SPEC
def test_vtu_holds_the_same_mesh_as_msh(spec, files):
    from_msh, from_vtu = meshio.gmsh.read(files[0]), meshio.vtu.read(files[1])
    assert np.array_equal(from_vtu.points, from_msh.points)
    ours, theirs = blocks(from_vtu, TAG_DATA), blocks(from_msh, "gmsh:physical")
    assert ours.keys() == theirs.keys()
    assert set(ours) == (
        {"hexahedron", "quad"} if spec.geometry_order == 1 else {"hexahedron27", "quad9"}
    )
    for kind in ours:
        assert np.array_equal(ours[kind][0], theirs[kind][0])
        assert np.array_equal(ours[kind][1], theirs[kind][1])


@EVERY_SPEC
def test_groups_have_the_right_members(spec, files):
    grid = pyvista.read(files[1])
    found = {tag: int(grid.cell_data[tag.name.lower()].sum()) for tag in Tag}
    assert found == {Tag.BODY: spec.n_cells, **spec.n_facets}
    for tag in Tag:
        inside = grid.cell_data[tag.name.lower()] == 1
        assert np.array_equal(inside, grid.cell_data[TAG_DATA] == tag)
    z = {tag: grid.extract_cells(grid.cell_data[TAG_DATA] == tag).points[:, 2] for tag in Tag}
    assert np.abs(z[Tag.TIP]).max() == 0
    assert z[Tag.TOP] == pytest.approx(spec.length_m, rel=1e-15)


@EVERY_SPEC
def test_meshio_and_gmsh_agree_on_points_and_volume(spec, files):
    with gmsh_model("again"):
        gmsh.merge(str(files[0]))
        volume = volume_m3("a mesh", read_cells("a mesh"))
        points = gmsh.model.mesh.getNodes()[1].reshape(-1, 3)
    assert volume == pytest.approx(meshed_volume_m3(spec), rel=1e-12)
    ours = meshio.vtu.read(files[1]).points
    assert np.array_equal(np.unique(ours, axis=0), np.unique(points, axis=0))


@EVERY_SPEC
def test_vtk_integrates_the_same_volume(spec, files):
    """By VTK's own shape functions, which know its own node order alone."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    nodes, weights = (nodes + 1) / 2, weights / 2
    volume = 0.0
    for cell in vtk_cells(files[1], vtk_class(spec)):
        n = cell.GetNumberOfPoints()
        points = np.array([cell.GetPoints().GetPoint(i) for i in range(n)])
        for i, j, k in np.ndindex(4, 4, 4):
            derivatives = [0.0] * (3 * n)
            cell.InterpolateDerivs((nodes[i], nodes[j], nodes[k]), derivatives)
            jacobian = np.reshape(derivatives, (3, n)) @ points
            determinant = np.linalg.det(jacobian)
            assert determinant > 0
            volume += weights[i] * weights[j] * weights[k] * determinant
    # Single precision would show as 1e-7.
    assert volume == pytest.approx(meshed_volume_m3(spec), rel=1e-11)


@EVERY_SPEC
def test_vtk_interpolates_a_quadratic_at_coordinates(spec, files):
    """Nodal values of a polynomial in the coordinates that the cells' space contains."""
    mesh = meshio.vtu.read(files[1])
    scale = np.array([1e-3, 1e-3, spec.length_m])

    def polynomial(x):
        x, y, z = np.moveaxis(np.asarray(x) / scale, -1, 0)
        linear = 1 + 2 * x - 3 * y + 0.5 * z
        straight = spec.geometry_order == 2 and isinstance(spec.section, Rectangle)
        return linear + (x * x - y * z + 0.7 * z * z + x * y) * straight

    mesh.point_data["f"] = polynomial(mesh.points)
    path = files[1].with_name("f.vtu")
    meshio.write(path, mesh)
    grid = pyvista.read(path)
    rng = np.random.default_rng(1)
    for index in rng.choice(np.flatnonzero(grid.cell_data[TAG_DATA] == Tag.BODY), 12):
        cell = vtk_class(spec)()
        cell.DeepCopy(grid.GetCell(index))
        ids = [cell.GetPointId(i) for i in range(cell.GetNumberOfPoints())]
        for inside in rng.random((4, 3)):
            x, functions = [0.0] * 3, [0.0] * len(ids)
            cell.EvaluateLocation(vtk.mutable(0), inside, x, functions)
            assert np.dot(functions, grid.point_data["f"][ids]) == pytest.approx(
                polynomial(x), rel=1e-12
            )


def measured(spec):
    with gmsh_model():
        build_model(spec)
        return measure_quality(spec)


def test_quality_of_cubes_is_perfect():
    quality = measured(MeshSpec(6.0, Rectangle(2.0, 3.0), (2, 3, 6)))
    assert (quality["n_cells"], quality["n_nodes"]) == (36, 3 * 4 * 7)
    ones = [value for name, value in quality.items() if name.startswith(("sicn", "scal", "asp"))]
    assert ones == pytest.approx([1.0] * 9, rel=1e-9)
    assert quality["edge_length_min_m"] == pytest.approx(1.0)
    assert quality["edge_length_max_m"] == pytest.approx(1.0)
    assert quality["volume_m3"] == pytest.approx(36.0, rel=1e-12)
    assert abs(quality["volume_error"]) < 1e-12


@pytest.mark.parametrize("order", [1, 2])
def test_quality_of_the_papers_bristle(order):
    quality = measured(MeshSpec(geometry_order=order))
    # Edges: 0.5 mm, 2.08 / 4 mm, 336.5 / 337 mm; per cell 4 of each.
    edges = np.array([0.5, 0.52, 336.5 / 337]) * 1e-3
    assert quality["n_cells"] == 1348
    assert quality["n_nodes"] == {1: 2 * 5 * 338, 2: 3 * 9 * 675}[order]
    assert quality["aspect_ratio_mean"] == pytest.approx(edges[2] / edges[0], rel=1e-9)
    assert quality["edge_length_min_m"] == pytest.approx(edges[0], rel=1e-9)
    assert quality["edge_length_mean_m"] == pytest.approx(edges.mean(), rel=1e-9)
    assert quality["edge_length_max_m"] == pytest.approx(edges[2], rel=1e-9)
    # Inverse condition of a diagonal Jacobian: 3 / (|J| |J⁻¹|) in the Frobenius norm.
    sicn = 3 / (np.linalg.norm(edges) * np.linalg.norm(1 / edges))
    assert quality["sicn_min"] == pytest.approx(sicn, rel=1e-6)


def test_quality_of_a_wire_tells_its_volume_error():
    quality = measured(MeshSpec(0.01, Circle(1e-3), (1, 1, 3)))
    # A square in its circle.
    assert quality["volume_error"] == pytest.approx(2 / np.pi - 1, rel=1e-9)
    assert 0 < quality["scaled_jacobian_min"] <= quality["scaled_jacobian_mean"] < 1


def test_quality_table_reads_back(tmp_path):
    quality = measured(MeshSpec(0.01, Circle(1e-3), (2, 1, 3), geometry_order=2))
    path = tmp_path / "quality.csv"
    write_csv(quality, path)
    assert b"\r" not in path.read_bytes()  # lines end as those of other tables do
    lines = path.read_text().splitlines()
    assert {row["measure"]: float(row["value"]) for row in csv.DictReader(lines)} == quality
    assert lines[0] == "measure,value,unit"
    assert len(lines) == 1 + 16
    assert [line.rsplit(",", 1)[1] for line in lines if line.startswith("edge_length")] == ["m"] * 3
    assert [line.rsplit(",", 1)[1] for line in lines if line.startswith("volume")] == ["m3", "1"]
