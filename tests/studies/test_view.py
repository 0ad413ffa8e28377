"""Pictures of a result against what the result holds, upright and leaning; and bad results."""

from __future__ import annotations

import json
import math
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import pyvista
from field_files import LENGTH_M as SHORT_M
from field_files import solid_of
from matplotlib import colormaps
from matplotlib.image import imread
from mpi4py import MPI
from PIL import Image, ImageSequence
from pvbatch import needs_pvbatch, run_pvbatch
from scipy.spatial import cKDTree

import bristle
from bristle.solver.bristle import Material
from bristle.solver.errors import InputError
from bristle.solver.paraview import FieldWriter, Phase
from bristle.solver.rigid import leaning, matrix_of, slope_normal
from bristle.studies.running.mark import MARK
from bristle.studies.running.progress import logged_to_terminal
from bristle.studies.view.field_series import FieldSeries
from bristle.studies.view.paraview_state import SCRIPT_FILE, write_state_script
from bristle.studies.view.pictures import (
    OUTLINE,
    Outside,
    Seen,
    animated,
    seen_from_the_side,
    space_time_figure,
    stills,
)
from bristle.studies.view.run import read_history, run_view, touch_time_s
from bristle.studies.view.wave import Levels, Stand, read_wave, round_factor

COMM = MPI.COMM_WORLD
LENGTH_M, HEIGHT_M, ITS_S, GRAVITY_M_S2 = 0.05, 0.02, 2.5e-7, 9.8
MATERIAL = Material(beta_s=1e-8)
LEAN_DEG, SLOPE_DEG = 8.0, -4.0
PERIOD_S = 2.0 * LENGTH_M / MATERIAL.bar_speed_m_s


def drop_solid(folder, **stand):
    """A short bristle's impact in ``folder``."""
    body = {"model": "solid", "length_m": LENGTH_M, "cells": (1, 2, 24), "beta_s": MATERIAL.beta_s}
    fall = {"height_m": HEIGHT_M, "kn_N_m": 2e7, "its_s": ITS_S, "until": "impact"}
    how = {"deflection": "small", "friction": 0.0, "comm": MPI.COMM_SELF}
    bristle.drop(**body, **fall, **how, **stand, out=folder)


@pytest.fixture(scope="module")
def dropped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dropped")
    drop_solid(folder)
    return folder


@pytest.fixture(scope="module")
def leaning_drop(tmp_path_factory):
    """The tip slides down a slope, its edge first."""
    folder = tmp_path_factory.mktemp("leaning")
    with pytest.warns(bristle.BristleWarning, match="leans by 12 degrees|over about 50.7 µm"):
        drop_solid(folder, tilt_deg=LEAN_DEG, slope_deg=SLOPE_DEG)
    return folder


@pytest.fixture(params=["dropped", "leaning_drop"])
def either(request):
    return request.getfixturevalue(request.param)


@pytest.fixture
def result(dropped, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(dropped, tmp_path / "result")


def touch_s_of(folder):
    return touch_time_s(read_history(folder / "history.csv"))


def wave_of(folder):
    with FieldSeries(folder / "fields" / "solid.bp") as series:
        return read_wave(series, touch_s_of(folder))


@pytest.fixture
def wave(dropped):
    return wave_of(dropped)


def colours(path):
    picture = np.asarray(imread(path))[..., :3]
    return len(np.unique((picture * 255).round().astype(np.uint8).reshape(-1, 3), axis=0))


@pytest.mark.serial
def test_all_pictures_of_a_solid(result, capfd):
    with logged_to_terminal():
        written = run_view(result, comm=MPI.COMM_SELF)
    told = [line for line in capfd.readouterr().err.splitlines() if "of the wave, frames" in line]
    with FieldSeries(result / "fields" / "solid.bp") as series:
        count = len(series.times_s)
    # each is read, those of the film once more
    total = count + min(count, 60)
    assert told[0].endswith(f"0 of {total}")
    assert told[-1].endswith(f"{total} of {total}")
    names = ["history", "space-time", "tip-stress", "wave"]
    expected = {f"{name}.{kind}" for name in names for kind in ("svg", "png")} | {"wave.gif"}
    assert {path.name for path in written if path.parent == result / "view"} == expected
    assert {path.name for path in (result / "view").iterdir()} == {*expected, MARK}
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
    with Image.open(result / "view" / "wave.gif") as gif:
        film = np.array([frame.convert("RGB") for frame in ImageSequence.Iterator(gif)], float)
    assert film.ndim == 4
    assert len(film) > 30
    assert np.abs(np.diff(film, axis=0)).mean(axis=(1, 2, 3)).min() > 0.0


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
def test_the_window_holds_every_frame_and_the_ground(either):
    wave = wave_of(either)
    left, right, bottom, top = wave.window_m
    assert len(stills(wave.times_s)) == 6
    assert wave.exaggeration > 1.0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    with FieldSeries(either / "fields" / "solid.bp") as series:
        nodes = series.nodes_m
        for frame in range(len(series.times_s)):
            motion = wave.stand.moved(nodes, series.read("displacement_m", frame))
            placed = wave.stand.drawn(nodes, motion, wave.exaggeration, wave.widenings)
            low, high = np.minimum(low, placed.min(axis=0)), np.maximum(high, placed.max(axis=0))
    ground = wave.ground_m(np.array([left, right]))
    assert left < low[wave.side] < high[wave.side] < right
    assert bottom < min(low[2], ground.min()) < max(high[2], ground.max()) < top
    # and is not much larger
    assert high[2] - min(low[2], ground.min()) > 0.9 * (top - bottom)
    assert high[wave.side] - low[wave.side] > 0.4 * (right - left)


@pytest.mark.serial
def test_a_leaning_bristle_stands_on_its_ground(leaning_drop):
    """In the world, and in the picture of the first touch, drawn with displacements enlarged."""
    wave = wave_of(leaning_drop)
    assert wave.side == 0
    assert matrix_of(leaning(LEAN_DEG)) == pytest.approx(wave.stand.turn, abs=1e-9)
    slope = math.tan(math.radians(SLOPE_DEG))
    assert wave.ground_m(np.array([1.0])) == pytest.approx(-slope)
    with FieldSeries(leaning_drop / "fields" / "solid.bp") as series:
        (seen,) = seen_from_the_side(series, wave, [0])
    across, height = seen.places_m[np.unique(seen.triangles)].T
    above = height - wave.ground_m(across)
    near = 1e-5 * LENGTH_M
    assert above.min() == pytest.approx(0.0, abs=near)
    # the edge that touches is the one toward which the bristle leans
    assert across[above < near] == pytest.approx(0.0, abs=near)
    lean = math.radians(LEAN_DEG)
    upper = height > height.max() - near
    half = 0.5 * wave.widening * wave.size_m[0]
    assert height.max() == pytest.approx(LENGTH_M * math.cos(lean) + 2.0 * half * math.sin(lean))
    ends = across[upper].mean(), across[upper].mean() + 2.0 * half * math.cos(lean)
    assert np.mean(ends) == pytest.approx(LENGTH_M * math.sin(lean) - half * math.cos(lean))


def test_of_a_surface_what_faces_the_eye_is_seen_the_nearest_on_top():
    """Two cubes in a row, seen askew: their shadows, the nearer one's last."""
    cube = pyvista.Box((0, 1, 0, 1, 0, 1)).triangulate()
    faces = cube.regular_faces
    places = np.vstack([cube.points, cube.points - [5.0, 0.0, 0.0]])
    both = np.vstack([faces, faces + len(cube.points)])
    toward = np.array([1.0, 0.5, 0.25]) / np.linalg.norm([1.0, 0.5, 0.25])
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    outside = Outside(np.arange(len(places)), both)
    seen = Seen.of(outside, places, places[:, 0], np.array([right, np.cross(toward, right)]))
    one, other, third = np.moveaxis(seen.places_m[seen.triangles], 1, 0)
    areas = 0.5 * (
        (other - one)[:, 0] * (third - one)[:, 1] - (other - one)[:, 1] * (third - one)[:, 0]
    )
    assert areas.min() > 0.0
    # a unit cube's shadow is the sum of its direction's components
    assert areas.sum() == pytest.approx(2.0 * toward.sum())
    nearer = (seen.triangles < len(cube.points)).all(axis=1)
    assert not nearer[: len(nearer) // 2].any()
    assert nearer[len(nearer) // 2 :].all()


@pytest.mark.serial
def test_no_more_than_a_frame_is_held_for_drawing(dropped):
    """Ten times as many frames take no more memory."""
    wave = wave_of(dropped)
    frames = animated(len(wave.times_s))
    peaks = []
    with FieldSeries(dropped / "fields" / "solid.bp") as series:
        for some in (frames[:1], frames[:4], frames[:40]):
            tracemalloc.start()
            for _ in seen_from_the_side(series, wave, some):
                pass
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[2] < 1.2 * peaks[1]


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
    touching = np.array([1e-3, -2e-3, 5e-3])
    rigid = (nodes - touching) @ turn.T - nodes
    stand = Stand.of(nodes, rigid)
    assert stand.turn == pytest.approx(turn, abs=1e-12)
    assert stand.touching_m == pytest.approx(touching, abs=1e-12)
    assert np.abs(stand.moved(nodes, rigid)).max() < 1e-15
    bent = np.zeros_like(nodes)
    bent[:, 0] = nodes[:, 2] ** 2
    placed = (nodes + bent - touching) @ turn.T
    moved = stand.moved(nodes, placed - nodes)
    assert moved == pytest.approx(bent, abs=1e-15)
    assert stand.drawn(nodes, moved, 1.0, np.ones(3)) == pytest.approx(placed, abs=1e-15)
    # where it touches it stays, however wide it is drawn
    there = stand.drawn(touching[None], np.zeros((1, 3)), 10.0, np.array([50.0, 1.0, 1.0]))
    assert there == pytest.approx(np.zeros((1, 3)), abs=1e-12)


@pytest.mark.parametrize(
    ("wanted", "there", "factor"),
    [(1.0, 3.0, 1.0), (1.0, 1.0, 1.0), (7.0, 1.0, 5.0), (0.3, 1e-3, 200.0), (1.0, 0.0, 1.0)],
)
def test_what_is_small_is_made_larger_by_round_factors(wanted, there, factor):
    assert round_factor(wanted, there) == pytest.approx(factor)


def test_levels_are_told_apart_and_bounded():
    x, y, z = np.meshgrid([-1.0, 0.1, 1.0], [-1.0, 0.0, 1.0], [0.0, 5.0, 2.0], indexing="ij")
    nodes = np.stack([x.ravel(), y.ravel(), z.ravel() + 1e-12 * x.ravel()], axis=1)
    levels = Levels.of(nodes)
    found = nodes[levels.axis]
    assert found == pytest.approx(np.array([[0.1, 0, 0], [0.1, 0, 2.0], [0.1, 0, 5.0]]))
    low, high = levels.bounds(nodes * np.array([2.0, 1.0, 1.0]))
    assert low == pytest.approx(np.array([[-2.0, -1, 0], [-2.0, -1, 2.0], [-2.0, -1, 5.0]]))
    assert high == pytest.approx(np.array([[2.0, 1, 0], [2.0, 1, 2.0], [2.0, 1, 5.0]]))


def test_a_series_of_several_ranks_is_read_in_one_piece(tmp_path):
    """Every rank reads what all wrote: each node once, values and cells those of its place."""
    folder = COMM.bcast(tmp_path)
    solid = solid_of()
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
        assert heights == pytest.approx(SHORT_M / 12)
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
        (lambda f: (f / "history.csv").unlink(), "history.csv: no such file"),
        (spoil_history, r"history.csv:4: tip_y_m is no number"),
        (spoil_column, r"history.csv:1: no column force_N"),
        (lambda f: (f / "history.csv").write_text(""), "history.csv: no table in it"),
        (lambda f: shutil.rmtree(f / "fields" / "solid.bp"), "there are no fields here"),
        (lambda f: (f / "fields" / "ground.vtk").unlink(), "no ground.vtk here"),
        (lambda f: (f / "fields" / "ground.vtk").write_text(""), "not a square of ground"),
        (lambda f: (f / "fields" / "solid.bp" / "md.idx").write_bytes(b""), "cannot be read"),
    ],
)
def test_a_spoilt_result_is_named_and_nothing_is_left(result, spoil, message):
    spoil(result)
    with pytest.raises(InputError, match=message):
        run_view(result, comm=MPI.COMM_SELF)
    assert not (result / "view").exists()


@pytest.mark.serial
@needs_pvbatch
def test_paraview_opens_the_result_in_one_step_wherever_it_is(result, tmp_path):
    script = write_state_script(result, "fields", wave_of(result), touch_s_of(result))
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


def contact_frames(folder, count=4):
    """Some frames of contact from the touch on: their times, least gaps, greatest pressures."""
    with FieldSeries(folder / "fields" / "tip.bp") as series:
        pressed = [i for i, phase in enumerate(series.phases) if phase is Phase.CONTACT]
        return [
            (series.times_s[i], series.read("gap_m", i).min(), series.read("pressure_Pa", i).max())
            for i in [0, *pressed[:: len(pressed) // count]]
        ]


def like(picture, map_, low, high):
    """Where a picture has the colours of a map from ``low`` to ``high`` of it."""
    colour = colormaps[map_](np.linspace(low, high, 64))[:, :3]
    return cKDTree(colour).query(picture.reshape(-1, 3))[0].reshape(picture.shape[:2]) < 0.04


@pytest.mark.serial
@needs_pvbatch
def test_paraview_shows_the_tip_on_the_ground_in_every_frame_of_contact(leaning_drop, tmp_path):
    frames = contact_frames(leaning_drop)
    result = shutil.copytree(leaning_drop, tmp_path / "result")
    script = write_state_script(result, "fields", wave_of(result), touch_s_of(result))
    answer = tmp_path / "answer.json"
    program = Path(__file__).parents[1] / "helpers" / "paraview_views.py"
    run_pvbatch(program, script, answer, *[t for t, _, _ in frames])
    normal, found = slope_normal(SLOPE_DEG), json.loads(answer.read_text())
    deepest, highest = min(gap for _, gap, _ in frames), max(p for _, _, p in frames)
    assert deepest < -1e-6
    for number, (_, gap, pressure) in enumerate(frames):
        ground, tip = (np.array(found[number][name]) for name in ("ground", "tip"))
        assert ground @ normal == pytest.approx(0.0, abs=1e-9)
        assert (tip @ normal).min() == pytest.approx(gap, abs=1e-9)
        low, high = ground[:, :2].min(axis=0), ground[:, :2].max(axis=0)
        assert (low < tip[:, :2]).all()
        assert (tip[:, :2] < high).all()
        picture = np.asarray(imread(tmp_path / f"answer-{number}.png"))[..., :3]
        # the whole stands on the plane, clear of axes and scale
        whole = picture[60:800, 170:570]
        grey = (np.abs(whole - 0.8) < 0.01).all(axis=-1)
        bristle = ((whole.min(axis=-1) < 0.99) & ~grey).sum(axis=1) > 20
        rows, foot = np.flatnonzero(grey.any(axis=1)), np.flatnonzero(bristle).max()
        assert rows[0] < foot < rows[-1]
        # the tip is seen, wherever it has gone, and what presses on it
        close = picture[60:800, 860:1270]
        assert (close.min(axis=-1) < 0.99).mean() > 0.3
        pressed = like(close, "inferno", 0.35, 0.9).mean()
        assert (pressed > 0.003) == (pressure > 0.4 * highest)
        assert (like(close, "viridis", 0.2, 0.9).mean() > 0.05) == (number > 1)
