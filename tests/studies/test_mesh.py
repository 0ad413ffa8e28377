"""`bristle mesh` leaves all of its files or none, on any number of ranks, with no screen."""

import csv
import signal
from pathlib import Path

import gmsh
import meshio
import numpy as np
import pytest
import pyvista
from mpi4py import MPI

from bristle.meshes.collective import run_on_one_rank
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.hexahedra import build_model, gmsh_model
from bristle.meshes.section import Circle, Rectangle
from bristle.solver.errors import ComputationError
from bristle.studies.inputs.limits import round_down
from bristle.studies.mesh import run as mesh_study
from bristle.studies.mesh.picture import VIEW_FROM, read_facets, thinned, write_vtu
from bristle.studies.mesh.run import run_mesh
from bristle.studies.running.files import write_atomically
from bristle.studies.running.interrupts import interruptible
from bristle.studies.running.mark import MARK

COMM = MPI.COMM_WORLD
FILES = ["bristle.msh", "bristle.vtu", "mesh.png", "quality.csv"]
SPEC = MeshSpec(0.02, Rectangle(), (1, 4, 10), geometry_order=2)


@pytest.fixture
def out(tmp_path):
    """Return a folder that is the same on every rank and does not exist yet."""
    return COMM.bcast(tmp_path, root=0) / "a" / "b"


def listing(folder):
    """Return the names in a folder but the mark, seen when every rank has come here."""
    names = run_on_one_rank(COMM, lambda: sorted(path.name for path in folder.iterdir()))
    return [name for name in names if name != MARK]


def written_quality(folder):
    """Return the measures in a folder's quality.csv."""
    lines = (folder / "quality.csv").read_text().splitlines()
    return {row["measure"]: float(row["value"]) for row in csv.DictReader(lines)}


@pytest.mark.parametrize(
    "spec", [SPEC, MeshSpec(0.02, Circle(1e-3), (2, 1, 6), geometry_order=1)], ids=["2", "wire-1"]
)
def test_all_files_are_there_and_agree(out, spec):
    summary = run_mesh(spec, out)
    assert listing(out) == FILES
    assert summary["files"] == {name: str(out / name) for name in FILES}
    assert summary["quality"]["n_cells"] == spec.n_cells
    assert COMM.bcast(summary) == summary
    assert written_quality(out) == summary["quality"]
    for mesh in (meshio.gmsh.read(out / "bristle.msh"), meshio.vtu.read(out / "bristle.vtu")):
        assert len(mesh.points) == summary["quality"]["n_nodes"]
        assert sum(len(block) for block in mesh.cells if block.dim == 3) == spec.n_cells
    image = pyvista.read(out / "mesh.png")
    assert image.dimensions[:2] == (1600, 900)
    assert is_drawn(image)


def is_drawn(image):
    """Return whether both halves show white ground, the grey of the side, the tip, and edges."""
    width, height, _ = image.dimensions
    pixels = image.point_data.active_scalars.reshape(height, width, -1)[:, :, :3].astype(int)
    wanted = [(255, 255, 255), (0xC9, 0xD3, 0xDC), (0xD9, 0x82, 0x2B), (0, 0, 0)]
    return all(
        np.count_nonzero(np.abs(half - colour).max(axis=2) <= 2) > 300
        for half in (pixels[:, : width // 2], pixels[:, width // 2 :])
        for colour in wanted
    )


def test_same_spec_gives_the_same_files(out):
    contents = []
    for _ in range(2):
        run_mesh(SPEC, out)
        contents.append({name: (out / name).read_bytes() for name in FILES})
        COMM.barrier()
    assert contents[0] == contents[1]


@pytest.mark.parametrize("stage", ["build_model", "measure_quality", "write_vtu", "write_picture"])
def test_failure_leaves_what_was_there(out, stage, monkeypatch):
    def fail(*_):
        raise OSError(28, f"no space for {stage}")

    monkeypatch.setattr(mesh_study, stage, fail)
    root = out.parent.parent
    with pytest.raises(OSError, match=f"no space for {stage}"):
        run_mesh(SPEC, out)
    assert listing(root) == []

    run_on_one_rank(COMM, lambda: write_atomically(out / "mesh.png", "older"))
    with pytest.raises(OSError, match=f"no space for {stage}"):
        run_mesh(SPEC, out)
    assert listing(out) == ["mesh.png"]
    assert (out / "mesh.png").read_text() == "older"


@pytest.mark.serial
def test_an_interruption_waits_until_all_files_are_in_place(out, monkeypatch):
    for name in FILES:
        write_atomically(out / name, "older")
    replace = Path.replace

    def interrupted(path, target):
        if path.name == FILES[0]:
            signal.raise_signal(signal.SIGTERM)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt), interruptible():
        run_mesh(SPEC, out)
    assert listing(out) == FILES
    assert all((out / name).read_bytes() != b"older" for name in FILES)


def test_unsound_mesh_writes_nothing(out, monkeypatch):
    build = mesh_study.build_model
    other = MeshSpec(0.02, Rectangle(), (1, 1, 1))
    monkeypatch.setattr(mesh_study, "build_model", lambda _: build(other))
    with pytest.raises(ComputationError, match="hexahedra"):
        run_mesh(SPEC, out)
    assert listing(out.parent.parent) == []


def test_older_files_are_replaced_and_strangers_kept(out):
    run_on_one_rank(COMM, lambda: write_atomically(out / "quality.csv", "older"))
    run_on_one_rank(COMM, lambda: (out / "notes.txt").write_text("mine"))
    run_mesh(SPEC, out)
    assert listing(out) == sorted([*FILES, "notes.txt"])
    assert written_quality(out)["n_cells"] == SPEC.n_cells


@pytest.mark.parametrize(
    ("limit", "length"),
    [(2.08, 2), (1.0, 1), (0.999, 0.5), (168.25, 100), (49.9, 20), (0.02, 0.02)],
)
def test_scale_bars_are_round(limit, length):
    assert round_down(limit) == pytest.approx(length)


def facets_of(spec, folder):
    """Return the facets of a mesh of `spec`, in mm."""
    with gmsh_model():
        build_model(spec)
        gmsh.write(str(folder / "a.msh"))
    write_vtu(folder / "a.msh", folder / "a.vtu")
    return read_facets(folder / "a.vtu")


@pytest.mark.parametrize("order", [1, 2])
def test_close_up_ends_with_a_whole_cell(tmp_path, order):
    spec = MeshSpec(0.02, Rectangle(), (1, 2, 10), order)
    facets = facets_of(spec, tmp_path)
    # Layers end at 0, 2, 4 … 20 mm.
    for height, end in ((3.0, 4.0), (4.0, 4.0), (25.0, 20.0)):
        assert facets.below(height).outline[..., 2].max() == pytest.approx(end)


@pytest.mark.parametrize("order", [1, 2])
def test_what_faces_the_camera_is_the_tip_and_the_near_sides(tmp_path, order):
    """It stands toward +x, -y and below; half of a wire's side is on the near side of its axis."""
    flat = facets_of(MeshSpec(0.02, Rectangle(), (3, 2, 5), order), tmp_path).facing()
    assert np.array_equal(np.unique(flat.tag), sorted([Tag.SIDE, Tag.TIP]))
    x, y, z = np.moveaxis(flat.outline, -1, 0)
    near = [np.isclose(x, x.max()), np.isclose(y, y.min()), np.isclose(z, 0.0)]
    assert [each.all(axis=1).sum() for each in near] == [2 * 5, 3 * 5, 3 * 2]
    assert len(flat.tag) == 2 * 5 + 3 * 5 + 3 * 2
    wire = facets_of(MeshSpec(0.02, Circle(1e-3), (4, 1, 3), order), tmp_path)
    middle = wire.facing().outline[wire.facing().tag == Tag.SIDE].mean(axis=1)
    assert (middle[:, :2] @ VIEW_FROM[:2] > 0.0).all()
    assert len(middle) == (wire.tag == Tag.SIDE).sum() / 2


def test_thinning_keeps_both_ends_and_the_lines_along(tmp_path):
    edges = facets_of(MeshSpec(0.02, Rectangle(), (1, 1, 100)), tmp_path).edges()

    def rings_and_lengths(edges):
        flat = np.ptp(edges[..., 2], axis=1) < 1e-9
        return np.unique(np.round(edges[flat, 0, 2], 6)), np.count_nonzero(~flat)

    rings, lengths = rings_and_lengths(thinned(edges, 10))
    assert (rings[0], rings[-1]) == (0, 20)
    assert 10 <= len(rings) <= 12
    assert lengths == rings_and_lengths(edges)[1]
    assert len(rings_and_lengths(thinned(edges, 1000))[0]) == 101
