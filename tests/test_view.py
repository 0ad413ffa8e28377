"""Do the pictures of a result show what the result holds, and does a bad result say so?"""

from __future__ import annotations

import csv
import json
import math
import shutil

import imageio.v3 as imageio
import numpy as np
import pytest
from matplotlib.image import imread
from mpi4py import MPI
from pvbatch import needs_pvbatch, run_pvbatch

from bristle.meshes.distribute import to_dolfinx
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.solver.bodies.reduced import reduce_solid
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.bristle import Material
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Linear
from bristle.solver.drop import DropPlan, simulate
from bristle.solver.errors import InputError
from bristle.solver.paraview import FieldWriter, Phase
from bristle.solver.rigid import leaning, matrix_of
from bristle.solver.time.march import Marcher
from bristle.solver.touch import HISTORY_COLUMNS
from bristle.studies.page.history_picture import read_history, touch_time_s
from bristle.studies.view import run_view
from bristle.studies.viewing.bristle_drawing import OUTLINE
from bristle.studies.viewing.field_series import FieldSeries
from bristle.studies.viewing.paraview_state import SCRIPT_FILE
from bristle.studies.viewing.stand import Stand
from bristle.studies.viewing.wave import axis_nodes, read_wave, round_factor
from bristle.studies.viewing.wave_pictures import plan_drawing, space_time_figure

COMM = MPI.COMM_WORLD
LENGTH_M, HEIGHT_M, ITS_S, GRAVITY_M_S2 = 0.05, 0.02, 2.5e-7, 9.8
MATERIAL = Material(beta_s=1e-8)
PERIOD_S = 2.0 * LENGTH_M / MATERIAL.bar_speed_m_s


def solid_of(comm):
    mesh, _, facets = to_dolfinx(MeshSpec(LENGTH_M, cells=(1, 2, 24)), comm)
    return SolidBody(mesh, facets, int(Tag.TIP), MATERIAL, 2)


def write_result(folder, history, model="solid"):
    document = {
        "schema": 1,
        "model": model,
        "contact": "penalty",
        "contact_time_s": history.contact_time_s,
        "inputs": {
            "kn_N_m": 2e6,
            "height_m": HEIGHT_M,
            "youngs_Pa": MATERIAL.youngs_Pa,
            "density_kg_m3": MATERIAL.density_kg_m3,
        },
    }
    (folder / "result.json").write_text(json.dumps(document))
    with (folder / "history.csv").open("w", newline="") as table:
        rows = csv.writer(table)
        rows.writerow(HISTORY_COLUMNS)
        rows.writerows(history.history.array().tolist())


def drop_solid(folder, comm):
    """A short bristle's impact in ``folder``, as `bristle drop --model solid` leaves it."""
    solid = solid_of(comm)
    frame = reduce_solid(solid, (2.0 / ITS_S) / (ITS_S / 2.0 + MATERIAL.beta_s), 20)
    plan = DropPlan(HEIGHT_M, ContactMethod(Linear(2e7)), ITS_S, GRAVITY_M_S2, impact_only=True)
    marcher = Marcher(solid, plan.method, plan.scheme, ITS_S, GRAVITY_M_S2)
    with FieldWriter(solid, folder / "fields", marcher) as writer:
        result = simulate(frame, plan, marcher, writer)
        writer.write_flight(frame, GRAVITY_M_S2, n_frames=20)
    solid.close()
    if comm.rank == 0:
        write_result(folder, result)
    comm.barrier()


@pytest.fixture(scope="module")
def dropped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dropped")
    drop_solid(folder, MPI.COMM_SELF)
    return folder


@pytest.fixture
def result(dropped, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(dropped, tmp_path / "result")


@pytest.fixture
def wave(dropped):
    history = read_history(dropped / "history.csv")
    with FieldSeries(dropped / "fields" / "solid.bp") as series:
        return read_wave(series, touch_time_s(history))


def colours(path):
    picture = np.asarray(imread(path))[..., :3]
    return len(np.unique((picture * 255).round().astype(np.uint8).reshape(-1, 3), axis=0))


@pytest.mark.serial
def test_all_pictures_of_a_solid(result):
    written = run_view(result, comm=MPI.COMM_SELF)
    names = ["history", "space-time", "tip-stress", "wave"]
    expected = {f"{name}.{kind}" for name in names for kind in ("svg", "png")} | {"wave.gif"}
    assert {path.name for path in written if path.parent == result / "view"} == expected
    assert {path.name for path in (result / "view").iterdir()} == expected
    assert result / SCRIPT_FILE in written
    for name in names:
        assert (result / "view" / f"{name}.svg").read_text().startswith("<?xml")
        assert colours(result / "view" / f"{name}.png") > 30
    # blue is compression: the picture of the wave shows it, and the running film changes
    still = np.asarray(imread(result / "view" / "wave.png"))[..., :3]
    bluish = (still[..., 2] - still[..., 0] > 0.3).mean()
    assert bluish > 0.01
    # the rim of the bristle, also where it has no stress
    grey = np.abs(still - OUTLINE).max(axis=-1) < 0.02
    assert grey.sum(axis=0).max() > 200
    film = imageio.imread(result / "view" / "wave.gif").astype(float)
    assert film.ndim == 4
    assert len(film) > 30
    assert np.abs(np.diff(film[:, ..., :3], axis=0)).mean(axis=(1, 2, 3)).min() > 0.0


@pytest.mark.serial
def test_pictures_again_in_another_folder_replace_the_old(result, tmp_path):
    out = tmp_path / "deep" / "pictures"
    shutil.rmtree(result / "fields")
    first = run_view(result, out, MPI.COMM_SELF)
    before = [path.read_bytes() for path in first]
    assert run_view(result, out, MPI.COMM_SELF) == first
    assert [path.read_bytes() for path in first] == before
    assert {path.name for path in first} == {"history.svg", "history.png"}
    assert not list(out.glob(".*"))


@pytest.mark.serial
def test_the_wave_runs_up_at_the_speed_of_a_bar(wave):
    """The front passes a quarter and three quarters of the length when d'Alembert's wave does."""
    half = 0.5 * np.abs(wave.axial_stress_Pa).max()
    arrivals = []
    for share in (0.25, 0.75):
        level = int(np.argmin(np.abs(wave.z_m - share * LENGTH_M)))
        pressed = -wave.axial_stress_Pa[:, level]
        first = int(np.argmax(pressed > half))
        before, after = pressed[first - 1], pressed[first]
        part = (half - before) / (after - before)
        t = wave.times_s[first - 1] + part * (wave.times_s[first] - wave.times_s[first - 1])
        arrivals.append(t)
    speed = 0.5 * LENGTH_M / (arrivals[1] - arrivals[0])
    assert speed == pytest.approx(MATERIAL.bar_speed_m_s, rel=0.05)


@pytest.mark.serial
def test_the_greatest_stress_is_the_bar_waves(wave):
    """Not above ρ c v, which a rigid plane would raise, and near it, the contact being stiff."""
    speed = np.sqrt(2.0 * GRAVITY_M_S2 * HEIGHT_M)
    bound = MATERIAL.density_kg_m3 * MATERIAL.bar_speed_m_s * speed
    contact = [i for i, phase in enumerate(wave.phases) if phase is Phase.CONTACT]
    pressed = -wave.axial_stress_Pa[contact].min()
    assert 0.85 * bound < pressed < 1.15 * bound
    assert wave.times_s[0] == pytest.approx(0.0, abs=ITS_S)


@pytest.mark.serial
def test_the_window_holds_every_frame(dropped, wave):
    drawing, stills = plan_drawing(wave)
    left, right, bottom, top = drawing.window_m
    assert len(stills) == 6
    assert drawing.exaggeration > 1.0
    with FieldSeries(dropped / "fields" / "solid.bp") as series:
        for frame in drawing.frames:
            motion = wave.stand.moved(series.nodes_m, series.read("displacement_m", frame))
            moved = series.nodes_m + drawing.exaggeration * motion
            assert left < moved[:, drawing.side].min() <= moved[:, drawing.side].max() < right
            assert bottom < moved[:, 2].min() <= moved[:, 2].max() < top


@pytest.mark.serial
def test_space_time_diagram_has_both_axes_and_the_path_of_the_wave(wave):
    plot = space_time_figure(wave, MATERIAL.bar_speed_m_s).axes[0]
    assert "mm" in plot.get_xlabel()
    assert "µs" in plot.get_ylabel()
    assert plot.get_xlim() == pytest.approx((0.0, LENGTH_M * 1e3))
    path = plot.lines[0].get_xydata()
    assert path[:3] == pytest.approx(
        np.array([[0.0, 0.0], [LENGTH_M * 1e3, 0.5e6 * PERIOD_S], [0.0, 1e6 * PERIOD_S]])
    )


def test_a_stand_is_taken_off_and_what_bends_is_left(rng):
    turn = np.asarray(matrix_of(leaning(7.0, -3.0)))
    nodes = rng.uniform(-1.0, 1.0, (40, 3)) * [2.5e-4, 1e-3, 0.1]
    shift = np.array([1e-3, -2e-3, 5e-3])
    rigid = nodes @ turn.T + shift - nodes
    stand = Stand.of(nodes, rigid)
    assert stand.turn == pytest.approx(turn, abs=1e-12)
    assert stand.lean_deg == pytest.approx(math.degrees(math.acos(turn[2, 2])))
    assert np.abs(stand.moved(nodes, rigid)).max() < 1e-15
    bent = np.zeros_like(nodes)
    bent[:, 0] = nodes[:, 2] ** 2
    moved = stand.moved(nodes, (nodes + bent) @ turn.T + shift - nodes)
    assert moved == pytest.approx(bent, abs=1e-15)


@pytest.mark.parametrize("side", [0, 1])
def test_the_plane_is_where_the_ground_is_for_a_leaning_bristle(side):
    turn, shift = np.asarray(matrix_of(leaning(20.0, 5.0))), np.array([0.01, 0.02, 0.003])
    lateral = np.array([-1e-3, 0.0, 2e-3])
    own = np.zeros((3, 3))
    own[:, side], own[:, 2] = lateral, Stand(turn, shift).plane_m(side, lateral)
    assert (own @ turn.T + shift)[:, 2] == pytest.approx(np.zeros(3), abs=1e-15)


@pytest.mark.parametrize(
    ("wanted", "there", "factor"),
    [(1.0, 3.0, 1.0), (1.0, 1.0, 1.0), (7.0, 1.0, 5.0), (0.3, 1e-3, 200.0), (1.0, 0.0, 1.0)],
)
def test_what_is_small_is_made_larger_by_round_factors(wanted, there, factor):
    assert round_factor(wanted, there) == pytest.approx(factor)


def test_axis_nodes_are_one_per_level():
    x, y, z = np.meshgrid([-1.0, 0.1, 1.0], [-1.0, 0.0, 1.0], [0.0, 5.0, 2.0], indexing="ij")
    nodes = np.stack([x.ravel(), y.ravel(), z.ravel() + 1e-12 * x.ravel()], axis=1)
    found = nodes[axis_nodes(nodes)]
    assert found == pytest.approx(np.array([[0.1, 0, 0], [0.1, 0, 2.0], [0.1, 0, 5.0]]))


def test_a_series_of_several_ranks_is_read_in_one_piece(tmp_path):
    """Every rank reads what all wrote: each node once, values and cells those of its place."""
    folder = COMM.bcast(tmp_path)
    solid = solid_of(COMM)
    z = solid.space.tabulate_dof_coordinates()[: solid.n_local // 3, 2]
    u = np.zeros((solid.n_local // 3, 3))
    u[:, 2] = 1e-3 * z**2
    with FieldWriter(solid, folder / "fields") as writer:
        writer.write(0.5, u.ravel(), 0.0 * u.ravel())
    COMM.barrier()
    with FieldSeries(folder / "fields" / "solid.bp") as series:
        assert series.times_s.tolist() == [0.5]
        assert len(series.nodes_m) == solid.n_dofs // 3
        assert len(np.unique(np.round(series.nodes_m, 9), axis=0)) == solid.n_dofs // 3
        assert np.array_equal(np.unique(series.cells), np.arange(len(series.nodes_m)))
        heights = np.ptp(series.nodes_m[series.cells, 2], axis=1)
        assert heights == pytest.approx(LENGTH_M / 24)
        moved = series.read("displacement_m", 0)
        assert moved[:, 2] == pytest.approx(1e-3 * series.nodes_m[:, 2] ** 2, abs=1e-16)
        with pytest.raises(InputError, match="no field temperature"):
            series.read("temperature", 0)
    with FieldSeries(folder / "fields" / "tip.bp") as series:
        assert series.read("gap_m", 0) == pytest.approx(0.0)
        assert series.cells.shape == (2, 9)
        assert len(series.nodes_m) == 15
    solid.close()
    COMM.barrier()


def test_view_raises_on_every_rank(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        run_view(tmp_path / "nowhere", comm=COMM)


def spoil_json(folder):
    (folder / "result.json").write_text('{\n"model": ')


def spoil_model(folder):
    (folder / "result.json").write_text("[]")


def spoil_history(folder):
    text = (folder / "history.csv").read_text().splitlines()
    text[3] = text[3].replace(",", ",x", 1)
    (folder / "history.csv").write_text("\n".join(text))


def spoil_column(folder):
    text = (folder / "history.csv").read_text()
    (folder / "history.csv").write_text(text.replace("force_N", "force_kN"))


@pytest.mark.serial
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "result.json").unlink(), "no result.json here"),
        (spoil_json, r"result.json:2: not valid JSON"),
        (spoil_model, "names no model"),
        (lambda f: (f / "history.csv").unlink(), "history.csv: cannot be read"),
        (spoil_history, r"history.csv:4: could not convert"),
        (spoil_column, r"history.csv:1: there is no column force_N"),
        (lambda f: (f / "history.csv").write_text(""), "there is no column t_s"),
        (lambda f: shutil.rmtree(f / "fields" / "solid.bp"), "there are no fields here"),
        (lambda f: (f / "fields" / "solid.bp" / "md.idx").write_bytes(b""), "cannot be read"),
    ],
)
def test_a_spoilt_result_is_named_and_nothing_is_left(result, spoil, message):
    spoil(result)
    with pytest.raises(InputError, match=message):
        run_view(result, comm=MPI.COMM_SELF)
    assert not (result / "view").exists() or not list((result / "view").iterdir())


@pytest.mark.serial
@needs_pvbatch
def test_paraview_opens_the_result_in_one_step_wherever_it_is(result, tmp_path):
    from bristle.studies.viewing.paraview_state import write_state_script

    history = read_history(result / "history.csv")
    touch = touch_time_s(history)
    with FieldSeries(result / "fields" / "solid.bp") as series:
        script = write_state_script(result, "fields", read_wave(series, touch), touch)
    moved = result.rename(tmp_path / "moved")
    run_pvbatch(moved / script.name, tmp_path / "state.png")
    picture = np.asarray(imread(tmp_path / "state.png"))[..., :3]
    assert picture.shape == (900, 1400, 3)
    assert colours(tmp_path / "state.png") > 100
    # the whole on the left and the tip on the right, each on white
    for half in (picture[:, :690], picture[:, 710:]):
        drawn = (half.min(axis=-1) < 0.9).mean()
        assert 0.05 < drawn < 0.9
    # the whole is pressed at this instant, so blue, and stands upright on the grey plane
    blue = picture[:, :550, 2] - picture[:, :550, 0] > 0.2
    rows, columns = np.flatnonzero(blue.any(axis=1)), np.flatnonzero(blue.any(axis=0))
    assert np.ptp(rows) > 2 * np.ptp(columns) > 100
    assert blue[rows[0] : rows[-1], columns[0] : columns[-1]].mean() > 0.5
