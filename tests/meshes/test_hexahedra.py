"""What gmsh makes of a bristle is all hexahedra, all sound, and in the right place."""

import os
import subprocess
import sys
import threading

import gmsh
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bristle.meshes.check import (
    MeshError,
    check_model,
    meshed_volume_m3,
    read_cells,
    volume_m3,
)
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.hexahedra import build_model, gmsh_model
from bristle.meshes.section import Circle, Rectangle

RECTANGLE = Rectangle(0.5e-3, 2.08e-3)
WIRE = Circle(1.2e-3)
SECTIONS = [RECTANGLE, WIRE]


def spec_of(section, cells=(2, 3, 4), order=1, grading=1.0, length_m=0.02):
    return MeshSpec(length_m, section, cells, order, grading)


@pytest.mark.parametrize("grading", [0.25, 1.0, 6.0])
@pytest.mark.parametrize("cells", [(1, 1, 1), (1, 4, 9), (3, 2, 5)])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("section", SECTIONS, ids=["rectangle", "wire"])
def test_mesh_passes_its_own_check(section, order, cells, grading):
    spec = spec_of(section, cells, order, grading)
    with gmsh_model():
        build_model(spec)
        check_model(spec)
        cells = read_cells("a mesh")
    z = cells.points[cells.corners, 2]
    assert np.unique(np.round(z, 12)) == pytest.approx(spec.levels_m, abs=1e-12)


@settings(max_examples=25, deadline=None, derandomize=True, database=None)
@given(
    cells=st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 12)),
    order=st.sampled_from([1, 2]),
    ratio=st.floats(0.05, 20.0),
    slenderness=st.floats(0.2, 400.0),
    grading=st.floats(0.05, 20.0),
    round_section=st.booleans(),
)
def test_any_division_gives_the_volume(cells, order, ratio, slenderness, grading, round_section):
    section = Circle(1e-3) if round_section else Rectangle(1e-3, ratio * 1e-3)
    spec = spec_of(section, cells, order, grading, length_m=slenderness * 1e-3)
    with gmsh_model():
        build_model(spec)
        check_model(spec)
        volume = volume_m3("a mesh", read_cells("a mesh"))
    assert volume == pytest.approx(meshed_volume_m3(spec), rel=1e-12)


@pytest.mark.parametrize(("order", "rate"), [(1, 2), (2, 4)])
def test_wire_volume_converges_at_its_rate(order, rate):
    errors = []
    for n in (2, 4, 8, 16):
        spec = spec_of(WIRE, (n, n, 1), order)
        with gmsh_model():
            build_model(spec)
            errors.append(abs(volume_m3("a mesh", read_cells("a mesh")) / spec.volume_m3 - 1))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    # The next term of the error is smaller by a² = (π / 4n)², about 0.15 at the coarsest.
    assert rates == pytest.approx(rate, abs=0.05)
    assert np.all(np.diff(np.abs(rates - rate)) < 0)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("section", SECTIONS, ids=["rectangle", "wire"])
def test_facets_point_outward(section, order):
    spec = spec_of(section, order=order)
    with gmsh_model():
        build_model(spec)
        kind = gmsh.model.mesh.getElementType("Quadrangle", order)
        points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss10")
        fluxes, areas = {}, {}
        for tag in (Tag.TIP, Tag.TOP, Tag.SIDE):
            fluxes[tag], areas[tag] = 0.0, np.zeros(3)
            for face in gmsh.model.getEntitiesForPhysicalGroup(2, tag):
                jacobians, _, x = gmsh.model.mesh.getJacobians(kind, points, face)
                columns = jacobians.reshape(-1, len(weights), 3, 3)
                normals = np.cross(columns[:, :, 0], columns[:, :, 1])
                x = x.reshape(normals.shape)
                fluxes[tag] += np.einsum("cqi,cqi,q->", x, normals, weights)
                areas[tag] += np.einsum("cqi,q->i", normals, weights)
    volume = meshed_volume_m3(spec)
    area = volume / spec.length_m
    assert areas[Tag.TIP] == pytest.approx([0, 0, -area], abs=1e-12 * area)
    assert areas[Tag.TOP] == pytest.approx([0, 0, area], abs=1e-12 * area)
    assert areas[Tag.SIDE] == pytest.approx([0, 0, 0], abs=1e-12 * area)
    assert fluxes[Tag.TIP] == pytest.approx(0, abs=1e-12 * volume)
    assert fluxes[Tag.TOP] == pytest.approx(volume, rel=1e-11)
    assert fluxes[Tag.SIDE] == pytest.approx(2 * volume, rel=1e-11)


def test_second_order_nodes_of_a_wire_lie_on_the_circle():
    spec = spec_of(WIRE, (2, 1, 2), order=2)
    with gmsh_model():
        build_model(spec)
        nodes, points = gmsh.model.mesh.getNodesForPhysicalGroup(2, Tag.SIDE)
    assert len(nodes) == 16 * 5
    radii = np.linalg.norm(points.reshape(-1, 3)[:, :2], axis=1)
    assert radii == pytest.approx(WIRE.diameter_m / 2, rel=1e-9)


def test_cells_of_a_wire_stay_far_from_degenerate():
    for n in (1, 2, 4, 8):
        with gmsh_model():
            build_model(spec_of(WIRE, (n, n, 2), order=2))
            cells = read_cells("a mesh").tags
            assert gmsh.model.mesh.getElementQualities(cells, "minSJ").min() > 0.5


def _move(node, by_m):
    x, parameters, *_ = gmsh.model.mesh.getNode(node)
    gmsh.model.mesh.setNode(node, x + np.array(by_m), parameters)


def _drop_a_cell():
    entity = gmsh.model.getEntities(3)[0][1]
    _, cells, _ = gmsh.model.mesh.getElements(3, entity)
    gmsh.model.mesh.removeElements(3, entity, cells[0][:1])


def _drop_tip_facets():
    gmsh.model.mesh.removeElements(2, gmsh.model.getEntitiesForPhysicalGroup(2, Tag.TIP)[0])


def _add_a_loose_node():
    gmsh.model.mesh.addNodes(0, gmsh.model.getEntities(0)[0][1], [10_000], [0.0, 0.0, 0.0])


def _add_a_numbered_node():
    last = len(gmsh.model.mesh.getNodes()[0])
    gmsh.model.mesh.addNodes(0, gmsh.model.getEntities(0)[0][1], [last + 1], [0.0, 0.0, 0.0])


def _add_a_tetrahedron():
    gmsh.model.mesh.addElementsByType(gmsh.model.getEntities(3)[0][1], 4, [], [1, 2, 3, 5])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_drop_a_cell, "23 hexahedra instead of 24"),
        (_drop_tip_facets, "tip must have quadrilaterals alone"),
        (_add_a_loose_node, "without gaps"),
        (_add_a_numbered_node, "1 nodes belong to no cell"),
        (_add_a_tetrahedron, "hexahedra alone, not .*Tetrahedron 4"),
        (lambda: _move(1, (0, 0, 0.03)), "inside out"),
        (lambda: _move(1, (0, 0, 1e-9)), "volume"),
    ],
)
def test_a_spoiled_mesh_is_refused(spoil, message):
    spec = spec_of(RECTANGLE)
    with gmsh_model():
        build_model(spec)
        check_model(spec)
        spoil()
        with pytest.raises(MeshError, match=message):
            check_model(spec)


def test_a_mesh_of_another_spec_is_refused():
    with gmsh_model():
        build_model(spec_of(RECTANGLE, (2, 2, 3)))
        with pytest.raises(MeshError, match="12 hexahedra instead of 18"):
            check_model(spec_of(RECTANGLE, (2, 3, 3)))
        with pytest.raises(MeshError, match="hexahedra alone"):
            check_model(spec_of(RECTANGLE, (2, 2, 3), order=2))
        with pytest.raises(MeshError, match="side has 24 facets instead of 30"):
            check_model(spec_of(RECTANGLE, (1, 4, 3)))
        with pytest.raises(MeshError, match="volume"):
            check_model(spec_of(RECTANGLE, (2, 2, 3), length_m=0.021))


def test_gmsh_is_left_as_it_was_found():
    assert not gmsh.isInitialized()
    with gmsh_model():
        assert gmsh.isInitialized()
    assert not gmsh.isInitialized()
    with pytest.raises(KeyError, match="mine"), gmsh_model():
        raise KeyError("mine")
    assert not gmsh.isInitialized()

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.ElementOrder", 3)
        gmsh.model.add("theirs")
        gmsh.model.geo.addPoint(1, 2, 3)
        gmsh.model.geo.synchronize()
        with gmsh_model():
            assert gmsh.model.getEntities() == []
            build_model(spec_of(RECTANGLE))
            check_model(spec_of(RECTANGLE))
        assert gmsh.isInitialized()
        assert gmsh.model.getCurrent() == "theirs"
        assert gmsh.model.list().count("theirs") == 1
        assert not [name for name in gmsh.model.list() if name.startswith("bristle")]
        assert len(gmsh.model.getEntities(0)) == 1
        assert gmsh.option.getNumber("Mesh.ElementOrder") == 3
    finally:
        gmsh.finalize()


def test_threads_take_turns():
    volumes, errors = {}, []

    def work(n):
        try:
            spec = spec_of(RECTANGLE, (1, 1, n), length_m=n * 1e-3)
            with gmsh_model():
                build_model(spec)
                check_model(spec)
                volumes[n] = volume_m3("a mesh", read_cells("a mesh")) / spec.volume_m3
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(1, 9)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert list(volumes.values()) == pytest.approx([1.0] * 8, rel=1e-12)


@pytest.mark.serial
def test_nothing_is_said_and_nothing_left_behind(tmp_path):
    program = (
        "from bristle.meshes.geometry import MeshSpec\n"
        "from bristle.meshes.hexahedra import build_model, gmsh_model\n"
        "with gmsh_model(): build_model(MeshSpec())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "HOME": str(tmp_path), "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert list(tmp_path.iterdir()) == []
