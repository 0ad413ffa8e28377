"""Is what ParaView gets what was computed: order, nodes, times and values?"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import adios2
import numpy as np
import pytest
from dolfinx import fem, geometry
from field_files import COMM, MATERIAL, blocks_of, phases, solid_of, times_of, written
from matplotlib.image import imread
from mpi4py import MPI
from pvbatch import needs_pvbatch, run_pvbatch
from scipy.spatial import cKDTree

from bristle.meshes.geometry import Wire
from bristle.solver.bodies.reduced import reduce_solid
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Linear
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.errors import ComputationError
from bristle.solver.paraview import FieldWriter, Phase
from bristle.solver.time.march import Marcher

KN_N_M, ITS_S, GRAVITY_M_S2 = 2e6, 5e-7, 9.8
ROUNDING_M = 1e-16  # of a place on the bristle, from which its displacement is a difference
LAGRANGE_HEXAHEDRON, LAGRANGE_QUADRILATERAL = 72, 70


@pytest.fixture
def shared_path(tmp_path):
    """One folder for all ranks, gone afterwards."""
    path = Path(COMM.bcast(str(tmp_path)))
    yield path
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(path, ignore_errors=True)


def evaluate(function, points):
    """The function at points (n, 3) by dolfinx, the same on every rank."""
    domain = function.function_space.mesh
    tree = geometry.bb_tree(domain, 3, padding=1e-9)
    found = geometry.compute_colliding_cells(
        domain, geometry.compute_collisions_points(tree, points), points
    )
    mine = [i for i in range(len(points)) if len(found.links(i))]
    size = function.function_space.dofmap.index_map_bs
    values = np.full((len(points), size), -np.inf)
    if mine:
        cells = [found.links(i)[0] for i in mine]
        values[mine] = function.eval(points[mine], cells).reshape(len(mine), size)
    out = np.empty_like(values)
    COMM.Allreduce(values, out, MPI.MAX)
    return out


def set_state(solid, field):
    """A vector of the solid's unknowns from ``field`` of coordinates (3, n)."""
    function = fem.Function(solid.space)
    function.interpolate(field)
    return function.x.array[: solid.n_local].copy()


def wavy(x):
    return 1e-6 * np.stack([np.sin(300 * x[2]), x[0] * 1e3 + x[1] ** 2 * 1e6, np.cos(200 * x[2])])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("section", [{}, {"section": Wire(1e-3), "cells": (1, 1, 12)}])
def test_order_nodes_and_values_are_kept(shared_path, order, section):
    solid = solid_of(order, **section)
    u, v = set_state(solid, wavy), set_state(solid, lambda x: 3.0 - 1e5 * wavy(x))
    with FieldWriter(solid, shared_path) as writer:
        writer.write(0.25, 0.0 * u, v)
        writer.write(0.5, u, v)
    COMM.barrier()
    path = shared_path / "solid.bp"
    assert times_of(path) == [0.25, 0.5]
    # what each field should be at the nodes found in the file
    for name, function in (
        ("displacement_m", writer.displacement),
        ("velocity_m_s", writer.velocity),
        ("axial_stress_Pa", writer.axial_stress),
        ("von_mises_Pa", writer.von_mises),
    ):
        found = written(path, name, 1)
        assert found["type"] == LAGRANGE_HEXAHEDRON
        assert found["nodes_per_cell"] == {(order + 1) ** 3}
        assert found["n_cells"] == solid.domain.topology.index_map(3).size_global
        assert len(np.unique(np.round(found["nodes"], 10), axis=0)) == solid.n_dofs // 3
        expected = evaluate(function, found["nodes"])
        scale = np.abs(expected).max()
        assert found["values"] == pytest.approx(expected, rel=0, abs=1e-9 * scale)
    at_rest = written(path, "displacement_m", 0)
    assert at_rest["values"] == pytest.approx(0.0, abs=ROUNDING_M)
    solid.close()


def test_a_rigid_height_is_in_the_displacement_and_no_stress(shared_path):
    solid = solid_of()
    with FieldWriter(solid, shared_path) as writer:
        writer.write(0.0, 0.01 * solid.translation[:, 2], solid.translation[:, 2])
    COMM.barrier()
    found = written(shared_path / "solid.bp", "displacement_m", 0)["values"]
    assert found == pytest.approx(np.tile([0.0, 0.0, 0.01], (len(found), 1)), abs=1e-15)
    assert written(shared_path / "tip.bp", "gap_m", 0)["values"] == pytest.approx(0.01)
    assert np.abs(written(shared_path / "solid.bp", "von_mises_Pa", 0)["values"]).max() < 1.0
    solid.close()


class Impact:
    """One impact of a short bristle, marched with a FieldWriter looking on."""

    def __init__(self, folder, comm=COMM, kn=KN_N_M, **options):
        self.solid = solid_of(comm=comm)
        shift = (2.0 / ITS_S) / (ITS_S / 2.0 + MATERIAL.beta_s)
        self.frame = reduce_solid(self.solid, shift, 20)
        plan = DropPlan(0.05, ContactMethod(Linear(kn)), ITS_S, GRAVITY_M_S2, impact_only=True)
        marcher = Marcher(self.solid, plan.method, plan.scheme, ITS_S, GRAVITY_M_S2)
        self.states = []

        def look(state, force):
            self.states.append((state, force))
            self.writer(state, force)

        self.writer = FieldWriter(self.solid, folder, marcher, **options)
        with self.writer:
            self.result = simulate(self.frame, plan, marcher, look)
            self.writer.write_flight(self.frame, GRAVITY_M_S2, n_frames=5)
        comm.barrier()


def test_frames_of_an_impact(shared_path):
    impact = Impact(shared_path, every=3)
    rows = phases(shared_path)
    times = [t for t, _ in rows]
    assert times == impact.writer.times_s
    assert times == times_of(shared_path / "solid.bp") == times_of(shared_path / "tip.bp")
    assert np.all(np.diff(times) > 0.0)
    assert rows[0] == (impact.states[0][0].t_s, Phase.TOUCH)
    last = impact.states[-1][0].t_s
    assert rows[-6] == (last, Phase.RELEASE)
    assert [phase for _, phase in rows[-5:]] == [Phase.FLIGHT] * 5
    contact = [t for t, phase in rows if phase == Phase.CONTACT]
    assert np.diff(contact) == pytest.approx(3 * ITS_S)
    impact.solid.close()


def test_pressure_integrates_to_the_force_and_gap_is_the_height(shared_path):
    impact = Impact(shared_path, every=1)
    by_time = {row[0]: row for row in impact.result.history.rows}
    path, tip = shared_path / "tip.bp", impact.writer._tip
    assert tip.area_m2 == pytest.approx(0.5e-3 * 2.08e-3)
    with adios2.FileReader(str(path)) as file:
        assert file.read("types").item() == LAGRANGE_QUADRILATERAL
        cells, nodes = blocks_of(file, "connectivity", 0), blocks_of(file, "geometry", 0)
        for step, (t, phase) in enumerate(phases(shared_path)):
            if phase == Phase.FLIGHT:
                continue
            pressure, gap = blocks_of(file, "pressure_Pa", step), blocks_of(file, "gap_m", step)
            force = sum(map(integral, nodes, cells, pressure))
            assert force == pytest.approx(by_time[t][3], rel=1e-9, abs=1e-9)
            moved = blocks_of(file, "displacement_m", step)
            for heights, displacement in zip(gap, moved, strict=True):
                assert heights[:, 0] == pytest.approx(displacement[:, 2], abs=ROUNDING_M)
            lowest = min(heights.min(initial=np.inf) for heights in gap)
            # there are contact points between the nodes, and one of them may be deeper
            assert max(-lowest, 0.0) == pytest.approx(by_time[t][4], rel=1e-4, abs=ROUNDING_M)
    impact.solid.close()


def integral(nodes, cells, values):
    """Of a biquadratic field over flat rectangles, from VTK's cells (count, then nine nodes)."""
    corner, edge, middle = 1.0 / 36.0, 4.0 / 36.0, 16.0 / 36.0  # Simpson's rule
    weights = np.array([corner] * 4 + [edge] * 4 + [middle])
    total = 0.0
    for cell in cells[:, 1:]:
        area = np.prod(np.ptp(nodes[cell, :2], axis=0))
        total += area * float(weights @ values[cell, 0])
    return total


def test_the_tip_in_its_own_file_moves_as_the_solid(shared_path):
    solid = solid_of()
    u = set_state(solid, wavy)
    with FieldWriter(solid, shared_path) as writer:
        writer.write(0.0, u, u)
    COMM.barrier()
    body = written(shared_path / "solid.bp", "displacement_m", 0)
    tip = written(shared_path / "tip.bp", "displacement_m", 0)
    assert tip["nodes_per_cell"] == {9}
    _, index = cKDTree(body["nodes"]).query(tip["nodes"])
    assert tip["values"] == pytest.approx(body["values"][index], abs=1e-18)
    solid.close()


def test_a_long_contact_stays_within_the_limit_and_is_covered_to_its_end(shared_path):
    impact = Impact(shared_path, kn=1e4, every=1, max_frames=40)
    rows = [(t, phase) for t, phase in phases(shared_path) if phase != Phase.FLIGHT]
    assert len(impact.states) > 100
    assert 20 < len(rows) <= 40
    assert rows[-1] == (impact.states[-1][0].t_s, Phase.RELEASE)
    gaps = np.diff([t for t, _ in rows]) / ITS_S
    assert gaps[:15] == pytest.approx(1.0)
    assert gaps.max() < 0.4 * len(impact.states)
    impact.solid.close()


def test_a_reduced_body_writes_the_solids_fields(shared_path):
    impact = Impact(shared_path / "full", every=1)
    frame, solid = impact.frame, impact.solid
    plan = DropPlan(0.05, ContactMethod(Linear(KN_N_M)), ITS_S, GRAVITY_M_S2, impact_only=True)
    marcher = Marcher(frame.modal, plan.method, plan.scheme, ITS_S, GRAVITY_M_S2)
    folder = shared_path / "reduced"
    with FieldWriter(solid, folder, marcher, every=1, expand=frame.from_modal) as writer:
        simulate(ModalFrame(frame.modal), plan, marcher, writer)
        writer.write_flight(ModalFrame(frame.modal), GRAVITY_M_S2, n_frames=5)
    COMM.barrier()
    full = written(shared_path / "full" / "solid.bp", "axial_stress_Pa", 10)["values"]
    reduced = written(folder / "solid.bp", "axial_stress_Pa", 10)["values"]
    assert len(phases(folder)) == len(phases(shared_path / "full"))
    assert reduced == pytest.approx(full, abs=1e-4 * np.abs(full).max())
    solid.close()


def test_no_form_is_compiled_while_frames_are_written(shared_path, monkeypatch):
    solid = solid_of()
    writer = FieldWriter(solid, shared_path)

    def refuse(*_, **__):
        raise AssertionError("compiled in the time loop")

    monkeypatch.setattr("dolfinx.jit.ffcx_jit", refuse)
    monkeypatch.setattr(fem, "form", refuse)
    monkeypatch.setattr(fem, "Expression", refuse)
    with writer:
        for k in range(3):
            writer.write(k, solid.translation[:, 2], solid.translation[:, 2])
    solid.close()


def test_the_writer_refuses_nonsense(shared_path):
    solid = solid_of()
    with pytest.raises(ValueError, match="every"):
        FieldWriter(solid, shared_path, every=0)
    with pytest.raises(ValueError, match="max_frames"):
        FieldWriter(solid, shared_path, max_frames=1)
    with FieldWriter(solid, shared_path) as writer:
        with pytest.raises(ValueError, match="first step"):
            writer.write_flight(None, GRAVITY_M_S2)
        writer.write(1.0, solid.translation[:, 2], solid.translation[:, 2])
        writer.write(1.0, solid.translation[:, 2], solid.translation[:, 2])
        assert writer.times_s == [1.0]
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write(2.0, solid.translation[:, 2], solid.translation[:, 2])
    solid.close()


def test_a_failing_run_closes_its_files(shared_path):
    solid = solid_of()
    with pytest.raises(RuntimeError, match="of all ranks"):  # noqa: PT012, SIM117
        with FieldWriter(solid, shared_path) as writer:
            writer.write(1.0, solid.translation[:, 2], solid.translation[:, 2])
            raise RuntimeError("of all ranks")
    with pytest.raises(ValueError, match="closed"):
        writer.write(2.0, solid.translation[:, 2], solid.translation[:, 2])
    COMM.barrier()
    assert times_of(shared_path / "solid.bp") == [1.0]
    solid.close()


def test_a_rank_that_fails_alone_does_not_wait_for_the_others(shared_path, monkeypatch):
    monkeypatch.setattr("bristle.solver.paraview.FAREWELL_S", 0.2)
    solid = solid_of()
    writer = FieldWriter(solid, shared_path)
    if COMM.rank == 0 and COMM.size > 1:
        with pytest.raises(RuntimeError), writer:
            raise RuntimeError("alone")
    COMM.barrier()
    if COMM.rank > 0:
        assert writer._all_failed()
    writer.close()
    solid.close()


def test_a_folder_that_cannot_be_written_is_said_on_every_rank(shared_path):
    solid = solid_of()
    if COMM.rank == 0:
        (shared_path / "file").write_text("")
    with pytest.raises(ComputationError, match="cannot be written"):
        FieldWriter(solid, shared_path / "file")
    solid.close()


@pytest.mark.serial
def test_an_earlier_run_is_replaced(tmp_path):
    solid = solid_of(comm=MPI.COMM_SELF)
    for times in ((0.0, 1.0, 2.0), (5.0,)):
        with FieldWriter(solid, tmp_path) as writer:
            for t in times:
                writer.write(t, solid.translation[:, 2], solid.translation[:, 2])
    assert times_of(tmp_path / "solid.bp") == [5.0]
    assert len(phases(tmp_path)) == 1
    solid.close()


@pytest.mark.serial
@pytest.mark.parametrize(("mesh_once", "meshes"), [(False, [1, 1, 1]), (True, [1, 0, 0])])
def test_the_mesh_goes_with_every_frame_unless_told_otherwise(tmp_path, mesh_once, meshes):
    solid = solid_of(comm=MPI.COMM_SELF)
    with FieldWriter(solid, tmp_path, mesh_once=mesh_once) as writer:
        for k in range(3):
            writer.write(k, solid.translation[:, 2], solid.translation[:, 2])
    with adios2.FileReader(str(tmp_path / "solid.bp")) as file:
        found = [len(file.engine.blocks_info("connectivity", k)) for k in range(3)]
    assert found == meshes
    solid.close()


@pytest.mark.serial
def test_many_writers_leave_no_open_files(tmp_path):
    solid = solid_of(comm=MPI.COMM_SELF)

    def one():
        with FieldWriter(solid, tmp_path) as writer:
            writer.write(0.0, solid.translation[:, 2], solid.translation[:, 2])

    one()
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        one()
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    solid.close()


KILLED = """
import os, signal, sys
sys.path.insert(0, {tests!r})
import test_paraview as t
from pathlib import Path
solid = t.solid_of()
writer = t.FieldWriter(solid, Path({folder!r}))
for k in range(4):
    writer.write(float(k), k * solid.translation[:, 2], solid.translation[:, 2])
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.serial
def test_a_killed_run_leaves_its_frames_readable(tmp_path):
    script = KILLED.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=300)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    for name, field in (("solid.bp", "displacement_m"), ("tip.bp", "gap_m")):
        assert times_of(tmp_path / name) == [0.0, 1.0, 2.0, 3.0]
        assert written(tmp_path / name, field, 3)["values"].max() == pytest.approx(3.0)
    assert [t for t, _ in phases(tmp_path)] == [0.0, 1.0, 2.0, 3.0]


READ_BY_PARAVIEW = Path(__file__).with_name("paraview_reads.py")


@pytest.mark.serial
@needs_pvbatch
def test_paraview_reads_and_draws_it(tmp_path):
    impact = Impact(tmp_path / "fields", comm=MPI.COMM_SELF, every=1)
    answer, png = tmp_path / "answer.json", tmp_path / "picture.png"
    step = 8
    run_pvbatch(READ_BY_PARAVIEW, tmp_path / "fields", step, answer, png)
    said = json.loads(answer.read_text())
    for name, kind, nodes in (
        ("solid.bp", LAGRANGE_HEXAHEDRON, 27),
        ("tip.bp", LAGRANGE_QUADRILATERAL, 9),
    ):
        found = said[name]
        assert found["times"] == impact.writer.times_s
        assert (found["cell_type"], found["nodes_per_cell"]) == (kind, nodes)
        for array, ranges in found["ranges"].items():
            data = written(tmp_path / "fields" / name, array, step)
            assert found["n_points"] == len(data["nodes"])
            assert found["n_cells"] == data["n_cells"]
            expected = np.stack([data["values"].min(axis=0), data["values"].max(axis=0)], axis=-1)
            assert np.array(ranges) == pytest.approx(expected, rel=1e-12)
    assert set(said["solid.bp"]["ranges"]) == {
        "displacement_m",
        "velocity_m_s",
        "axial_stress_Pa",
        "von_mises_Pa",
    }
    picture = imread(png)[..., :3]
    assert picture.std() > 0.05
    assert len(np.unique((picture * 255).astype(np.uint8).reshape(-1, 3), axis=0)) > 30
    impact.solid.close()
