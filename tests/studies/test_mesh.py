"""`bristle mesh` leaves all of its files or none, on any number of ranks, with no screen."""

import csv
import signal
import subprocess
import sys
import time
from pathlib import Path

import gmsh
import meshio
import numpy as np
import pytest
import pyvista
from faults import left_running
from mpi4py import MPI

from bristle.meshes.collective import run_on_one_rank
from bristle.meshes.geometry import MeshSpec
from bristle.meshes.hexahedra import build_model, gmsh_model
from bristle.meshes.section import Circle, Rectangle
from bristle.solver.errors import ComputationError
from bristle.studies.mesh import picture
from bristle.studies.mesh import run as mesh_study
from bristle.studies.mesh.picture import (
    DrawingError,
    below,
    read_facets,
    round_length_mm,
    run_drawing,
    thinned,
    write_picture,
    write_vtu,
)
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
        contents.append({name: (out / name).read_bytes() for name in FILES if name != "mesh.png"})
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


SAY_DISPLAY = ["sh", "-c", 'echo "$DISPLAY" > "$0"; sleep "$1"']
# The process that serves a display, from the X server's lock.
SAY_SERVER = ["sh", "-c", 'cat "/tmp/.X${DISPLAY#:}-lock" > "$0"; sleep "$1"']


def started(server_file):
    """The server of a drawing that has begun."""
    deadline = time.monotonic() + 30
    while not (server_file.exists() and server_file.read_text().endswith("\n")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    server = int(server_file.read_text())
    assert left_running([server], 0.0) == [server]
    return server


@pytest.mark.serial
def test_display_ends_with_its_drawing(tmp_path):
    run_drawing([*SAY_SERVER, str(tmp_path / "pid"), "0"])
    assert left_running([int((tmp_path / "pid").read_text())], 10.0) == []


@pytest.mark.serial
def test_display_ends_when_its_caller_is_killed(tmp_path):
    # No MPI in there: under mpirun it would pass for one of the ranks.
    program = (
        "import sys; from bristle.studies.mesh.picture import run_drawing as run; run(sys.argv[1:])"
    )
    drawing = [*SAY_SERVER, str(tmp_path / "pid"), "60"]
    caller = subprocess.Popen([sys.executable, "-c", program, *drawing])
    server = started(tmp_path / "pid")
    caller.kill()
    caller.wait()
    assert left_running([server], 10.0) == []


@pytest.mark.serial
def test_drawing_that_cannot_be_says_why(tmp_path, monkeypatch):
    with pytest.raises(DrawingError, match=r"Drawing failed: .*missing\.vtu"):
        write_picture(tmp_path / "missing.vtu", tmp_path / "a.png")
    with pytest.raises(DrawingError, match="Drawing failed: SIGABRT"):
        run_drawing([sys.executable, "-c", "import os; os.abort()"])
    with pytest.raises(DrawingError, match="more than 2 s"):
        run_drawing([*SAY_SERVER, str(tmp_path / "pid"), "60"], timeout_s=2)
    assert left_running([int((tmp_path / "pid").read_text())], 10.0) == []

    monkeypatch.setattr(picture.shutil, "which", lambda name: None)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(DrawingError, match="install Xvfb or set DISPLAY"):
        run_drawing(["true"])
    monkeypatch.setenv("DISPLAY", ":77")
    run_drawing([*SAY_DISPLAY, str(tmp_path / "own"), "0"])
    assert (tmp_path / "own").read_text() == ":77\n"


@pytest.mark.parametrize(
    ("limit", "length"),
    [(2.08, 2), (1.0, 1), (0.999, 0.5), (168.25, 100), (49.9, 20), (0.02, 0.02)],
)
def test_scale_bars_are_round(limit, length):
    assert round_length_mm(limit) == pytest.approx(length)


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
        assert below(facets, height).points[:, 2].max() == pytest.approx(end)


def test_thinning_keeps_both_ends_and_the_lines_along(tmp_path):
    edges = facets_of(MeshSpec(0.02, Rectangle(), (1, 1, 100)), tmp_path).extract_all_edges()

    def rings_and_lengths(thing):
        z = thing.points[thing.lines.reshape(-1, 3)[:, 1:], 2]
        flat = np.ptp(z, axis=1) < 1e-9
        return np.unique(np.round(z[flat, 0], 6)), np.count_nonzero(~flat)

    rings, lengths = rings_and_lengths(thinned(edges, 10))
    assert (rings[0], rings[-1]) == (0, 20)
    assert 10 <= len(rings) <= 12
    assert lengths == rings_and_lengths(edges)[1]
    assert len(rings_and_lengths(thinned(edges, 1000))[0]) == 101
