"""A mesh that left gmsh comes back the same, and VTK understands it."""

import csv

import gmsh
import meshio
import numpy as np
import pytest
import pyvista
import vtk

from bristle.meshes.check import integrated_volume_m3, meshed_volume_m3
from bristle.meshes.convert import TAG_DATA, read_msh, read_vtu, write_msh, write_vtu
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.hexahedra import build_model, gmsh_model
from bristle.meshes.quality import MeshQuality, measure_quality, write_csv
from bristle.meshes.section import Circle, Rectangle

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
        write_msh(msh)
    write_vtu(read_msh(msh), vtu)
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


@EVERY_SPEC
def test_vtu_holds_the_same_mesh_as_msh(spec, files):
    from_msh, from_vtu = read_msh(files[0]), read_vtu(files[1])
    assert [block.type for block in from_vtu.cells] == (
        ["hexahedron", "quad"] if spec.geometry_order == 1 else ["hexahedron27", "quad9"]
    )
    assert np.array_equal(from_vtu.points, from_msh.points)
    for ours, theirs in zip(from_vtu.cells, from_msh.cells, strict=True):
        assert np.array_equal(ours.data, theirs.data)
    for ours, theirs in zip(
        from_vtu.cell_data[TAG_DATA], from_msh.cell_data[TAG_DATA], strict=True
    ):
        assert np.array_equal(ours, theirs)
    assert from_vtu.cell_sets.keys() == from_msh.cell_sets.keys()


@EVERY_SPEC
def test_sets_have_the_right_members(spec, files):
    mesh = read_msh(files[0])
    sets = mesh.cell_sets
    assert {name: [len(part) for part in parts] for name, parts in sets.items()} == {
        "body": [spec.n_cells, 0],
        **{tag.name.lower(): [0, number] for tag, number in spec.n_facets.items()},
    }
    z = mesh.points[mesh.cells[1].data][:, :, 2]
    assert np.abs(z[sets["tip"][1]]).max() == 0
    assert z[sets["top"][1]] == pytest.approx(spec.length_m, rel=1e-15)
    grid = pyvista.read(files[1])
    assert int(grid.cell_data["tip"].sum()) == spec.n_section_cells
    assert np.array_equal(grid.cell_data["body"] == 1, grid.cell_data[TAG_DATA] == Tag.BODY)


@EVERY_SPEC
def test_meshio_and_gmsh_agree_on_points_and_volume(spec, files):
    with gmsh_model("again"):
        gmsh.merge(str(files[0]))
        volume, smallest = integrated_volume_m3(spec.geometry_order)
        points = gmsh.model.mesh.getNodes()[1].reshape(-1, 3)
    assert smallest > 0
    assert volume == pytest.approx(meshed_volume_m3(spec), rel=1e-12)
    ours = read_vtu(files[1]).points
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
    mesh = read_vtu(files[1])
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


def test_what_is_no_bristle_is_refused(tmp_path):
    path = tmp_path / "a.msh"
    path.write_text("no mesh\n")
    with pytest.raises(ValueError, match=r"a\.msh is not a mesh that meshio can read"):
        read_msh(path)
    with pytest.raises(FileNotFoundError):
        read_msh(tmp_path / "missing.msh")
    msh = tmp_path / "cut.msh"
    with gmsh_model():
        build_model(SPECS[0])
        write_msh(msh)
    msh.write_bytes(msh.read_bytes()[:2000])
    with pytest.raises(ValueError, match=r"cut\.msh is not a mesh that meshio can read"):
        read_msh(msh)
    with pytest.raises(FileNotFoundError):
        read_vtu(tmp_path / "missing.vtu")
    triangle = meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])])
    meshio.write(path, triangle, file_format="gmsh")
    with pytest.raises(ValueError, match="no physical groups"):
        read_msh(path)
    tagged = meshio.Mesh(np.eye(3), triangle.cells, cell_data={TAG_DATA: [np.array([1])]})
    meshio.write(tmp_path / "b.vtu", tagged)
    with pytest.raises(ValueError, match="expected hexahedra and quadrilaterals, found"):
        read_vtu(tmp_path / "b.vtu")
    meshio.write(tmp_path / "c.vtu", triangle)
    with pytest.raises(ValueError, match="no cell data 'tag'"):
        read_vtu(tmp_path / "c.vtu")


def measured(spec):
    with gmsh_model():
        build_model(spec)
        return measure_quality(spec)


def test_quality_of_cubes_is_perfect():
    quality = measured(MeshSpec(6.0, Rectangle(2.0, 3.0), (2, 3, 6)))
    assert (quality.n_cells, quality.n_nodes) == (36, 3 * 4 * 7)
    ones = [value for name, value, _ in quality.rows() if name.startswith(("sicn", "scal", "asp"))]
    assert ones == pytest.approx([1.0] * 9, rel=1e-9)
    assert quality.edge_length_min_m == pytest.approx(1.0)
    assert quality.edge_length_max_m == pytest.approx(1.0)
    assert quality.volume_m3 == pytest.approx(36.0, rel=1e-12)
    assert abs(quality.volume_error) < 1e-12


@pytest.mark.parametrize("order", [1, 2])
def test_quality_of_the_papers_bristle(order):
    quality = measured(MeshSpec(geometry_order=order))
    # Edges: 0.5 mm, 2.08 / 4 mm, 336.5 / 337 mm; per cell 4 of each.
    edges = np.array([0.5, 0.52, 336.5 / 337]) * 1e-3
    assert quality.n_cells == 1348
    assert quality.n_nodes == {1: 2 * 5 * 338, 2: 3 * 9 * 675}[order]
    assert quality.aspect_ratio_mean == pytest.approx(edges[2] / edges[0], rel=1e-9)
    assert quality.edge_length_min_m == pytest.approx(edges[0], rel=1e-9)
    assert quality.edge_length_mean_m == pytest.approx(edges.mean(), rel=1e-9)
    assert quality.edge_length_max_m == pytest.approx(edges[2], rel=1e-9)
    # Inverse condition of a diagonal Jacobian: 3 / (|J| |J⁻¹|) in the Frobenius norm.
    sicn = 3 / (np.linalg.norm(edges) * np.linalg.norm(1 / edges))
    assert quality.sicn_min == pytest.approx(sicn, rel=1e-6)


def test_quality_of_a_wire_tells_its_volume_error():
    quality = measured(MeshSpec(0.01, Circle(1e-3), (1, 1, 3)))
    # A square in its circle.
    assert quality.volume_error == pytest.approx(2 / np.pi - 1, rel=1e-9)
    assert 0 < quality.scaled_jacobian_min <= quality.scaled_jacobian_mean < 1


def test_quality_table_reads_back(tmp_path):
    quality = measured(MeshSpec(0.01, Circle(1e-3), (2, 1, 3), geometry_order=2))
    path = tmp_path / "quality.csv"
    write_csv(quality, path)
    lines = path.read_text().splitlines()
    assert {row["measure"]: float(row["value"]) for row in csv.DictReader(lines)} == vars(quality)
    assert lines[0] == "measure,value,unit"
    assert len(lines) == 1 + len(MeshQuality.__dataclass_fields__)
    assert [line.rsplit(",", 1)[1] for line in lines if line.startswith("edge_length")] == ["m"] * 3
    assert [line.rsplit(",", 1)[1] for line in lines if line.startswith("volume")] == ["m3", "1"]
