"""The fields for ParaView: order, nodes, times, values, and where they stand in the world."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import adios2
import numpy as np
import pytest
import pyvista
from dolfinx import fem, geometry
from field_files import COMM, LENGTH_M, MATERIAL, blocks_of, phases, solid_of, times_of, written
from matplotlib.image import imread
from mpi4py import MPI
from pvbatch import needs_pvbatch, run_pvbatch
from scipy.spatial import cKDTree

from bristle.meshes import collective
from bristle.meshes.section import Circle
from bristle.solver.bodies.floating import FloatingModel
from bristle.solver.bodies.matrices import NodeMass
from bristle.solver.bodies.reduced import reduce_solid
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.drop import DropPlan, simulate
from bristle.solver.errors import ComputationError
from bristle.solver.forms import own_values
from bristle.solver.ground import Ground
from bristle.solver.nodal_stress import NodalStress
from bristle.solver.paraview import BETWEEN, FieldWriter, Phase
from bristle.solver.rigid import slope_normal
from bristle.solver.time.march import Marcher
from bristle.solver.tip_face import TipFace

KN_N_M, ITS_S, GRAVITY_M_S2 = 2e6, 5e-7, 9.8
HELPERS = Path(__file__).parents[1] / "helpers"
ROUNDING_M = 1e-16  # of a place on the bristle, from which its displacement is a difference
POINT_M = 1e-9  # to which the places of contact points are known
LAGRANGE_HEXAHEDRON, LAGRANGE_QUADRILATERAL = 72, 70


def shared_by_ranks(path):
    """One folder for all ranks, gone afterwards."""
    path = Path(COMM.bcast(str(path)))
    yield path
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def shared_path(tmp_path):
    yield from shared_by_ranks(tmp_path)


@pytest.fixture
def solid():
    made = solid_of()
    yield made
    made.close()


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
@pytest.mark.parametrize("section", [{}, {"section": Circle(1e-3), "cells": (1, 1, 12)}])
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


def test_a_rigid_height_is_in_the_displacement_and_no_stress(solid, shared_path):
    with FieldWriter(solid, shared_path) as writer:
        writer.write(0.0, 0.01 * solid.translation[:, 2], solid.translation[:, 2])
    COMM.barrier()
    found = written(shared_path / "solid.bp", "displacement_m", 0)["values"]
    assert found == pytest.approx(np.tile([0.0, 0.0, 0.01], (len(found), 1)), abs=1e-15)
    assert written(shared_path / "tip.bp", "gap_m", 0)["values"] == pytest.approx(0.01)
    assert np.abs(written(shared_path / "solid.bp", "von_mises_Pa", 0)["values"]).max() < 1.0


class Impact:
    """One impact of a short bristle, marched with a FieldWriter looking on."""

    def __init__(self, folder, comm=COMM, kn=KN_N_M, spec=None, stand=None, until=None, **options):
        self.solid = solid_of(comm=comm, **(spec or {}))
        shift = (2.0 / ITS_S) / (ITS_S / 2.0 + MATERIAL.beta_s)
        tilt, slope, friction = stand or (0.0, 0.0, 0.0)
        self.frame = reduce_solid(self.solid, shift, 20, leaning=tilt != 0.0 or slope != 0.0)
        self.normal = slope_normal(slope)
        plan = DropPlan(
            0.05,
            ContactMethod(Linear(kn), friction=Coulomb(friction)),
            ITS_S,
            GRAVITY_M_S2,
            until_s=until,
            impact_only=until is None,
            tilt_deg=tilt,
            tilt_wide_deg=0.5 * tilt,
            ground=Ground.plane(len(self.solid.contact.weights), self.normal),
        )
        marcher = Marcher(self.solid, plan.method, plan.scheme, ITS_S, GRAVITY_M_S2)
        self.states = []

        def look(state, force):
            self.states.append((state, force))
            self.writer(state, force)

        self.writer = FieldWriter(self.solid, folder, marcher, self.frame, **options)
        with self.writer:
            self.result = simulate(self.frame, plan, marcher, look)
            self.writer.write_flight(n_frames=5)
        comm.barrier()
        self.solid.close()


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


# lean of the bristle and the surface's in degrees, friction, and which bristle
LEANING = (6.0, 0.0, 0.2)
STANDS = {
    "upright": ((0.0, 0.0, 0.0), {}),
    "leaning": (LEANING, {}),
    "on a slope": ((2.0, -5.0, 0.0), {}),
    "wire": (LEANING, {"section": Circle(1e-3), "cells": (1, 1, 12)}),
    "round": (LEANING, {"section": Circle(1e-3), "cells": (2, 2, 6), "geometry_order": 2}),
}


@pytest.fixture(scope="module", params=STANDS.values(), ids=STANDS)
def landed(request, tmp_path_factory):
    """An impact on each stand, the folder with a frame of every step, and the bristle's lean."""
    stand, spec = request.param
    for folder in shared_by_ranks(tmp_path_factory.mktemp("landed")):
        yield Impact(folder, every=1, stand=stand, spec=spec), folder, stand[0]


def test_pressure_integrates_to_the_force_and_gap_is_the_height(landed):
    """Whatever touches: the whole face, its edge over one cell, or a part of a round one.

    There are more points than nodes, but for the round one, whose curved cells they do not
    integrate over exactly.
    """
    impact, folder, _ = landed
    by_time = {row[0]: row for row in impact.result.history.rows}
    pressed = 0
    with adios2.FileReader(str(folder / "tip.bp")) as file:
        assert file.read("types").item() == LAGRANGE_QUADRILATERAL
        cells, nodes = blocks_of(file, "connectivity", 0), blocks_of(file, "geometry", 0)
        for step, (t, phase) in enumerate(phases(folder)):
            if phase == Phase.FLIGHT:
                continue
            pressure, gap = blocks_of(file, "pressure_Pa", step), blocks_of(file, "gap_m", step)
            force = sum(map(integral, nodes, cells, pressure))
            assert force == pytest.approx(by_time[t][3], rel=1e-10, abs=1e-10)
            pressed += by_time[t][3] > 1.0
            moved = blocks_of(file, "displacement_m", step)
            for heights, places, displacement in zip(gap, nodes, moved, strict=True):
                above = (places + displacement) @ impact.normal
                assert heights[:, 0] == pytest.approx(above, abs=POINT_M)
            lowest = min(heights.min(initial=np.inf) for heights in gap)
            # there are contact points between the nodes, and one of them may be deeper
            assert max(-lowest, 0.0) == pytest.approx(by_time[t][4], rel=1e-3, abs=POINT_M)
    assert pressed > 20


def integral(nodes, cells, values):
    """Of a biquadratic field over flat cells with round sides, VTK's (count, then nine nodes)."""
    points, weights = np.polynomial.legendre.leggauss(4)
    order = [(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1)]
    shape = [np.poly1d([0.5, -0.5, 0]), np.poly1d([-1, 0, 1]), np.poly1d([0.5, 0.5, 0])]
    total = 0.0
    for x, wx in zip(points, weights, strict=True):
        for y, wy in zip(points, weights, strict=True):
            at = np.array([shape[i](x) * shape[j](y) for i, j in order])
            along_x = np.array([shape[i].deriv()(x) * shape[j](y) for i, j in order])
            along_y = np.array([shape[i](x) * shape[j].deriv()(y) for i, j in order])
            for cell in cells[:, 1:]:
                area = np.cross(along_x @ nodes[cell], along_y @ nodes[cell])
                total += wx * wy * np.linalg.norm(area) * float(at @ values[cell, 0])
    return total


def test_the_tip_first_touches_at_the_origin_of_the_ground(landed):
    impact, folder, lean_deg = landed
    corners = np.asarray(pyvista.read(folder / "ground.vtk").points)
    assert corners @ impact.normal == pytest.approx(0.0, abs=1e-9)
    assert corners.mean(axis=0) == pytest.approx(0.0, abs=1e-9)
    tip = written(folder / "tip.bp", "displacement_m", 0)
    placed = tip["nodes"] + tip["values"]
    assert (placed @ impact.normal).min() == pytest.approx(0.0, abs=POINT_M)
    touching = placed[placed @ impact.normal < POINT_M]
    assert 0.5 * (touching.min(axis=0) + touching.max(axis=0)) == pytest.approx(
        0.0, abs=2.0 * POINT_M
    )
    # rigid and turned as it was released, its upper end toward the thin and half as far the wide
    body = written(folder / "solid.bp", "displacement_m", 0)
    placed = body["nodes"] + body["values"]
    on_axis = [np.argmin(np.linalg.norm(body["nodes"] - [0, 0, z], axis=1)) for z in (0, LENGTH_M)]
    axis = placed[on_axis[1]] - placed[on_axis[0]]
    leaning = np.degrees(np.arctan(axis[:2] / axis[2]))
    assert leaning == pytest.approx([lean_deg, 0.5 * lean_deg], abs=1e-9)
    assert np.linalg.norm(axis) == pytest.approx(LENGTH_M)


def test_the_tip_in_its_own_file_moves_as_the_solid(solid, shared_path):
    u = set_state(solid, wavy)
    with FieldWriter(solid, shared_path) as writer:
        writer.write(0.0, u, u)
    COMM.barrier()
    body = written(shared_path / "solid.bp", "displacement_m", 0)
    tip = written(shared_path / "tip.bp", "displacement_m", 0)
    assert tip["nodes_per_cell"] == {9}
    _, index = cKDTree(body["nodes"]).query(tip["nodes"])
    assert tip["values"] == pytest.approx(body["values"][index], abs=1e-18)


def test_flights_from_touch_to_touch_are_shown(shared_path):
    """In equal steps, along the parabola of the centre of mass."""
    impact = Impact(shared_path, every=5, until=0.35)
    rows = phases(shared_path)
    flown = [step for step, (_, phase) in enumerate(rows[:-5]) if phase == Phase.FLIGHT]
    first, last = flown[0], flown[-1]
    assert flown == list(range(first, last + 1))
    assert len(flown) == BETWEEN
    assert (rows[first - 1][1], rows[last + 1][1]) == (Phase.RELEASE, Phase.TOUCH)
    times = np.array([t for t, _ in rows[first - 1 : last + 2]])
    assert np.ptp(np.diff(times)) < 1e-12
    nodes = written(shared_path / "solid.bp", "displacement_m", 0)["nodes"]
    middle = np.argmin(np.linalg.norm(nodes - [0, 0, 0.5 * LENGTH_M], axis=1))
    heights = [
        written(shared_path / "solid.bp", "displacement_m", step)["values"][middle, 2]
        for step in range(first - 1, last + 2)
    ]
    since = times - times[0]
    speed = impact.result.cm_velocity_after_m_s
    # within what the short bristle rings and has sunk in by the release
    assert heights == pytest.approx(since * (speed - 0.5 * GRAVITY_M_S2 * since), abs=1e-4)
    assert max(heights) > 0.01


def test_a_long_contact_stays_within_the_limit_and_is_covered_to_its_end(shared_path):
    impact = Impact(shared_path, kn=1e4, every=1, max_frames=40)
    rows = [(t, phase) for t, phase in phases(shared_path) if phase != Phase.FLIGHT]
    assert len(impact.states) > 100
    assert 20 < len(rows) <= 40
    assert rows[-1] == (impact.states[-1][0].t_s, Phase.RELEASE)
    gaps = np.diff([t for t, _ in rows]) / ITS_S
    assert gaps[:15] == pytest.approx(1.0)
    assert gaps.max() < 0.4 * len(impact.states)


def test_no_form_is_compiled_while_frames_are_written(solid, shared_path, monkeypatch):
    writer = FieldWriter(solid, shared_path)

    def refuse(*_, **__):
        raise AssertionError("compiled in the time loop")

    monkeypatch.setattr("dolfinx.jit.ffcx_jit", refuse)
    monkeypatch.setattr(fem, "form", refuse)
    monkeypatch.setattr(fem, "Expression", refuse)
    with writer:
        for k in range(3):
            writer.write(k, solid.translation[:, 2], solid.translation[:, 2])


def test_the_writer_refuses_nonsense(solid, shared_path):
    with pytest.raises(ValueError, match="every"):
        FieldWriter(solid, shared_path, every=0)
    with pytest.raises(ValueError, match="max_frames"):
        FieldWriter(solid, shared_path, max_frames=1)
    with FieldWriter(solid, shared_path) as writer:
        with pytest.raises(ValueError, match="first step"):
            writer.write_flight()
        writer.write(1.0, solid.translation[:, 2], solid.translation[:, 2])
        writer.write(1.0, solid.translation[:, 2], solid.translation[:, 2])
        assert writer.times_s == [1.0]
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write(2.0, solid.translation[:, 2], solid.translation[:, 2])


def test_a_failing_run_closes_its_files(solid, shared_path):
    with pytest.raises(RuntimeError, match="of all ranks"):  # noqa: PT012, SIM117
        with FieldWriter(solid, shared_path) as writer:
            writer.write(1.0, solid.translation[:, 2], solid.translation[:, 2])
            raise RuntimeError("of all ranks")
    with pytest.raises(ValueError, match="closed"):
        writer.write(2.0, solid.translation[:, 2], solid.translation[:, 2])
    COMM.barrier()
    assert times_of(shared_path / "solid.bp") == [1.0]


@pytest.mark.skipif(COMM.size == 1, reason="needs a rank that does not fail")
@pytest.mark.parametrize("others_fail", [False, True])
def test_a_rank_that_fails_alone_leaves_nobody_waiting(
    solid, shared_path, monkeypatch, others_fail
):
    """Those that come after it has left, by an error of theirs or at the end, do not wait to close
    together."""
    monkeypatch.setattr(collective, "GRACE_S", 0.2)
    writer = FieldWriter(solid, shared_path)
    if COMM.rank == 0 or others_fail:
        time.sleep(COMM.rank)  # until the one before has left
        with pytest.raises(RuntimeError), writer:
            raise RuntimeError("alone")
    else:
        time.sleep(1.0)
        with writer:
            pass
    assert writer._writers
    COMM.barrier()
    writer.close()


@pytest.mark.skipif(COMM.size == 1, reason="needs a rank that finds nothing wrong")
def test_what_one_rank_finds_all_raise(solid, monkeypatch):
    """Places that one rank does not find, and numbers that it alone finds wrong."""
    if COMM.rank == 1:
        monkeypatch.setattr("bristle.solver.tip_face.SAME_POINT_M", -1.0)
    with pytest.raises(ComputationError, match="of the tip"):
        TipFace(solid)
    if COMM.rank == 1:
        monkeypatch.setattr(np, "array_equal", lambda *_: False)
    with pytest.raises(ComputationError, match="apart"):
        NodeMass(solid.space, 7800.0)


def test_frames_of_a_flight_are_those_of_the_body_itself(solid):
    """Displacement, velocity and stress, but for the square of the slope that the modes leave out.

    The body itself is what would touch in their place: the motion at finite strain that has the
    stress of the modes.
    """
    model = FloatingModel(**vars(reduce_solid(solid, 1e12, 12, leaning=True, flying=True)))
    bent = np.argsort(model.modal.omega2)[6:9]
    stresses = [NodalStress(fem.Function(solid.space), MATERIAL, finite=f) for f in (False, True)]
    off = []
    for slope in (2e-2, 1e-2):
        q = np.zeros(model.modal.n_dofs)
        shapes = np.abs(model.from_modal(np.eye(q.size)[:, bent])).max(axis=0)
        q[bent] = slope * LENGTH_M / 10.0 / shapes
        qv = 1e3 * q
        shown, direct = model.from_modal(np.column_stack([q, qv])).T, model.landed(q, qv)
        found = [*zip(shown, direct, strict=True)]
        pair = []
        for stress, state in zip(stresses, (shown, direct), strict=True):
            own_values(stress.displacement, state[0])
            pair.append(stress()[: solid.n_local // 3])
        found.append(tuple(pair))
        # of the greatest that any rank has
        apart = [COMM.allreduce(np.abs(a - b).max(), MPI.MAX) for a, b in found]
        size = [COMM.allreduce(np.abs(b).max(), MPI.MAX) for _, b in found]
        off.append(np.array(apart) / size)
    # the displacement lacks ½ θ², its own size being θ, and the velocity θ dθ/dt
    assert off[0].max() < 2.0 * 2e-2
    assert off[0] / off[1] == pytest.approx(2.0, rel=0.2)


def test_a_folder_that_cannot_be_written_is_said_on_every_rank(solid, shared_path):
    if COMM.rank == 0:
        (shared_path / "file").write_text("")
    with pytest.raises(ComputationError, match="cannot be written"):
        FieldWriter(solid, shared_path / "file")


@pytest.mark.serial
def test_an_earlier_run_is_replaced(solid, tmp_path):
    for times in ((0.0, 1.0, 2.0), (5.0,)):
        with FieldWriter(solid, tmp_path) as writer:
            for t in times:
                writer.write(t, solid.translation[:, 2], solid.translation[:, 2])
    assert times_of(tmp_path / "solid.bp") == [5.0]
    assert len(phases(tmp_path)) == 1


@pytest.mark.serial
def test_the_mesh_goes_with_every_frame(solid, tmp_path):
    with FieldWriter(solid, tmp_path) as writer:
        for k in range(3):
            writer.write(k, solid.translation[:, 2], solid.translation[:, 2])
    with adios2.FileReader(str(tmp_path / "solid.bp")) as file:
        found = [len(file.engine.blocks_info("connectivity", k)) for k in range(3)]
    assert found == [1, 1, 1]


@pytest.mark.serial
def test_many_writers_leave_no_open_files(solid, tmp_path):

    def one():
        with FieldWriter(solid, tmp_path) as writer:
            writer.write(0.0, solid.translation[:, 2], solid.translation[:, 2])

    one()
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        one()
    assert len(list(Path("/proc/self/fd").iterdir())) == before


KILLED = """
import os, signal, sys
sys.path.insert(0, {helpers!r})
from pathlib import Path
from field_files import solid_of
from bristle.solver.paraview import FieldWriter
solid = solid_of()
writer = FieldWriter(solid, Path({folder!r}))
for k in range(4):
    writer.write(float(k), k * solid.translation[:, 2], solid.translation[:, 2])
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.serial
def test_a_killed_run_leaves_its_frames_readable(tmp_path):
    script = KILLED.format(helpers=str(HELPERS), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=300)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    for name, field in (("solid.bp", "displacement_m"), ("tip.bp", "gap_m")):
        assert times_of(tmp_path / name) == [0.0, 1.0, 2.0, 3.0]
        assert written(tmp_path / name, field, 3)["values"].max() == pytest.approx(3.0)
    assert [t for t, _ in phases(tmp_path)] == [0.0, 1.0, 2.0, 3.0]


READ_BY_PARAVIEW = HELPERS / "paraview_reads.py"


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
