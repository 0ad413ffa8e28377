"""A brush does what it is told, writes what it promises, and goes on where it was interrupted."""

import json
import math
import xml.etree.ElementTree as ET

import av
import numpy as np
import pandas as pd
import pytest
import pyvista
import readme
from commands import mpirun
from elastica import filament
from hostile import refused, run
from pvbatch import needs_pvbatch, run_pvbatch
from web_page import Page

import bristle
from bristle.meshes.collective import ALONE
from bristle.solver import paper
from bristle.solver.rods.rods import Rods
from bristle.studies.brush import run as study
from bristle.studies.brush.inputs import BrushInputs
from bristle.studies.brush.record import STATES
from bristle.studies.inputs.brush_fields import BRUSH_FLAGS
from bristle.studies.inputs.sources import checked, inputs_of
from bristle.studies.running.mark import MARK
from bristle.studies.surface.ground import surface_of
from bristle.studies.view.brush_pictures import BrushSeries

pytestmark = pytest.mark.serial
HUB = ["t_s", "fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"]
TIPS = ["t_s", "bristle", "x_m", "y_m", "z_m", "normal_N", "friction_N", "state", "between_N"]
ENERGY = {
    *("hub_work_J", "kinetic_J", "strain_J", "contact_J", "material_loss_J", "friction_loss_J"),
    *("numerical_J", "closure_relative"),
}
# Of the paper's bristle, about the axis that it bends easily about.
EI = paper.YOUNGS_PA * paper.WIDTH_M * paper.THICKNESS_M**3 / 12.0
WEIGHT_N = (
    paper.DENSITY_KG_M3 * paper.WIDTH_M * paper.THICKNESS_M * paper.LENGTH_M * paper.GRAVITY_M_S2
)
SHORT = {"elements": 6, "start_s": 0.01, "until_s": 0.02, "every_s": 0.002, "penetration_m": 0.005}
FLAGS = [
    *("--elements", "6", "--start", "0.01", "--until", "0.02", "--every", "0.002"),
    *("--penetration", "0.005"),
]


def brush(**values):
    return checked(BrushInputs, {**SHORT, **values})


def path_file(folder, rows):
    """A path of the hub, of the rows of time and place; it does not turn."""
    lines = ["t_s,x_m,y_m,z_m,rx_rad,ry_rad,rz_rad"]
    lines += [",".join(map(str, (*row, 0, 0, 0))) for row in rows]
    path = folder / "path.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Three bristles in a row, dragged for 20 ms."""
    out = tmp_path_factory.mktemp("brush")
    status, _, _ = run("brush", "--layout", "row", "--count", "3", *FLAGS, "--out", out)
    assert status == 0
    return out


# --- what is written ------------------------------------------------------------------------------


def test_the_files_have_what_other_programs_read(done):
    document = json.loads((done / "result.json").read_text())
    hub, tips = pd.read_csv(done / "hub.csv"), pd.read_csv(done / "tips.csv")
    assert list(hub.columns) == HUB
    assert list(tips.columns) == TIPS
    np.testing.assert_allclose(hub.t_s, np.linspace(0.0, 0.02, 11), atol=1e-12)
    np.testing.assert_allclose(tips.t_s, np.repeat(hub.t_s, 3))
    assert set(tips.bristle) == {0, 1, 2}
    assert set(tips.state) <= {"free", "stick", "slip"}
    assert document["energy"].keys() >= ENERGY
    assert {"inputs", "version", "schema", "mark", "wall_s", "ranks"} <= document.keys()
    means = pd.read_csv(done / "means.csv")
    assert list(means.columns) == ["from_s", "to_s", *HUB[1:], "in_contact", "sticking", "slipping"]
    np.testing.assert_allclose(means.to_s, 1e-3 * np.arange(1, 21))
    assert document["window_s"] == pytest.approx(1e-3)
    later = means[means.to_s > document["steady_from_s"] + 5e-4]
    assert len(later) == 10
    force = later[["fx_N", "fy_N", "fz_N"]]
    np.testing.assert_allclose(document["force_N"]["mean"], force.mean(), rtol=1e-9)
    rms = np.sqrt((force**2).mean())
    np.testing.assert_allclose(document["force_N"]["rms"], rms, rtol=1e-9)
    size = np.sqrt((force**2).sum(axis=1))
    assert document["force_N"]["greatest_size"] == pytest.approx(size.max())
    shares = document["tips_share"]
    for name in ("in_contact", "sticking", "slipping"):
        assert shares[name] == pytest.approx(later[name].mean())
    assert shares["in_contact"] == pytest.approx(shares["sticking"] + shares["slipping"])
    # friction at rest is unknown and begins with none, so what touches sticks
    assert "slip" not in set(tips.state[tips.t_s == 0.0])
    assert not (done / "checkpoint").exists()


def test_the_page_shows_forces_tips_shape_and_stress(done):
    page = (done / "report.html").read_text()
    for name in ("force", "torque", "shares", "shape", "stress"):
        drawn = (done / "figures" / f"{name}.svg").read_text()
        assert len(drawn) > 1000
        assert "data:image" not in drawn
    for words in ("yield strength", "The surface is a plane", "bristle brush --layout"):
        assert words in page
    # the mean of the vector, which does not grow with shorter windows as its mean size does
    force = json.loads((done / "result.json").read_text())["force_N"]
    assert force["mean_size"] > 1.5 * np.linalg.norm(force["mean"])
    headline = "".join(Page(page).text).partition("on the hub is (")[2]
    numbers = headline.partition(")")[0].replace("−", "-").replace("·10", "e").split(",")
    said = [float(each) for each in numbers]
    assert said == pytest.approx(force["mean"], rel=5e-3)
    shape = pd.read_csv(done / "tables" / "shape.csv")
    tips = pd.read_csv(done / "tips.csv")
    last = tips[tips.t_s == tips.t_s.max()]
    drawn = shape.groupby("bristle").last()
    np.testing.assert_allclose(drawn.z_mm, 1e3 * last.z_m, rtol=1e-12)
    np.testing.assert_allclose(drawn.y_mm, 1e3 * last.y_m, rtol=1e-12)


def test_paraviews_series_has_a_line_for_each_bristle(done):
    root = ET.parse(done / "fields" / "brush.pvd").getroot()
    entries = [dict(each.attrib) for each in root.iter("DataSet")]
    frames = [each for each in entries if each["part"] == "0"]
    tips, hub = pd.read_csv(done / "tips.csv"), pd.read_csv(done / "hub.csv")
    np.testing.assert_allclose([float(each["timestep"]) for each in frames], hub.t_s)
    for number in (0, 7, 10):
        grid = pyvista.read(done / "fields" / frames[number]["file"])
        assert [grid.get_cell(i).n_points for i in range(grid.n_cells)] == [7, 7, 7]
        now = tips[tips.t_s == hub.t_s[number]]
        ends = np.array([grid.get_cell(i).points[-1] for i in range(3)])
        np.testing.assert_allclose(ends, now[["x_m", "y_m", "z_m"]], atol=1e-12)
        np.testing.assert_allclose(grid.cell_data["normal_N"], now.normal_N)
        np.testing.assert_allclose(grid.cell_data["friction_N"], now.friction_N)
        assert grid.point_data["bending_stress_Pa"].shape == (21,)
    ground = pyvista.read(done / "fields" / "ground.vtu")
    assert ground.bounds[4] == ground.bounds[5] == 0.0
    low, high = tips[["x_m", "y_m"]].min(), tips[["x_m", "y_m"]].max()
    assert ground.bounds[0] < low.x_m < high.x_m < ground.bounds[1]
    assert ground.bounds[2] < low.y_m < high.y_m < ground.bounds[3]


def test_view_makes_a_film_and_pictures_of_it(done, tmp_path):
    status, _, _ = run("view", done, "--out", tmp_path / "view")
    assert status == 0
    names = {path.name for path in (tmp_path / "view").iterdir()}
    drawn = {f"{name}.{kind}" for name in ("loads", "shape") for kind in ("svg", "png")}
    assert {"brush.mp4", *drawn} <= names
    with av.open(str(tmp_path / "view" / "brush.mp4")) as film:
        pictures = [frame.to_ndarray(format="gray") for frame in film.decode(video=0)]
    assert len(pictures) == 11
    changed = np.abs(pictures[0].astype(int) - pictures[-1]) > 60
    assert 20 < changed.sum() < 0.05 * changed.size
    series = BrushSeries.of(done / "fields")
    points, stress, states = series.read(7)
    tips = pd.read_csv(done / "tips.csv")
    now = tips[tips.t_s == series.times_s[7]]
    np.testing.assert_allclose(points[:, -1, 2], 1e3 * now.z_m)
    # as seen from the hub: the middle of three clamps in a row
    middle = points[:, 0, :2].mean(axis=0)
    np.testing.assert_allclose(middle, 0.0, atol=1e-9)
    assert stress.shape == (3, 7)
    assert [STATES[state] for state in states] == list(now.state)


def test_view_tells_what_of_a_brush_is_missing(done, tmp_path):
    for name in ("result.json", "means.csv", "fields"):
        (tmp_path / name).symlink_to(done / name)
    (tmp_path / "means.csv").unlink()
    assert "means.csv" in refused("view", tmp_path, "--out", tmp_path / "view")
    (tmp_path / "means.csv").symlink_to(done / "means.csv")
    (tmp_path / "fields").unlink()
    (tmp_path / "fields").mkdir()
    assert "not a series of a brush" in refused("view", tmp_path, "--out", tmp_path / "view")
    (tmp_path / "fields").rmdir()
    status, _, lines = run("view", tmp_path, "--out", tmp_path / "view")
    assert status == 0
    assert any("without --no-fields" in line for line in lines)
    assert not (tmp_path / "view" / "brush.mp4").exists()


IN_PARAVIEW = """
import json, sys
from paraview.simple import ExtractSurface, OpenDataFile, Tube
series = OpenDataFile(sys.argv[1])
series.UpdatePipeline(series.TimestepValues[-1])
information = series.GetDataInformation()
names = [series.PointData.GetArray(i).Name for i in range(series.PointData.GetNumberOfArrays())]
cells = [series.CellData.GetArray(i).Name for i in range(series.CellData.GetNumberOfArrays())]
counts = information.GetNumberOfPoints(), information.GetNumberOfCells()
tube = Tube(Input=ExtractSurface(Input=series))
tube.UpdatePipeline(series.TimestepValues[-1])
thick = tube.GetDataInformation().GetNumberOfPoints()
print(json.dumps([list(series.TimestepValues), *counts, names, cells, thick]))
"""


@needs_pvbatch
def test_paraview_itself_opens_it(done, tmp_path):
    program = tmp_path / "opens.py"
    program.write_text(IN_PARAVIEW)
    said = run_pvbatch(program, done / "fields" / "brush.pvd").splitlines()[-1]
    times, points, cells, names, of_cells, thick = json.loads(said)
    np.testing.assert_allclose(times, np.linspace(0.0, 0.02, 11), atol=1e-12)
    assert (points, cells) == (3 * 7 + 4, 3 + 1)
    assert thick > 3 * 3 * 7
    assert "bending_stress_Pa" in names
    assert {"bristle", "normal_N", "friction_N", "state"} <= set(of_cells)


# --- what it computes -----------------------------------------------------------------------------


def test_a_hub_at_rest_in_the_air_carries_the_weight(tmp_path):
    """Three upright bristles 0.1 m in front of the hub: weight and its lever, to rounding."""
    path = path_file(tmp_path, [(0, 0, 0, 0.4), (0.02, 0, 0, 0.4)])
    inputs = {"motion": f"file:{path}", "mount_angle_deg": 0.0}
    inputs |= {"penetration_m": None, "start_s": None}
    found = bristle.brush(**{**SHORT, **inputs}, layout="row", count=3, rows=3, comm=ALONE)
    np.testing.assert_allclose(found.hub.fz_N, -3.0 * WEIGHT_N, rtol=1e-6)
    np.testing.assert_allclose(found.hub[["fx_N", "fy_N"]], 0.0, atol=1e-6 * WEIGHT_N)
    assert set(found.tips.state) == {"free"}
    assert "no bristle touches" in found.warnings[-1]


def test_a_hub_that_turns_in_the_air_has_no_tips_that_bounce(tmp_path):
    """Once about x in 0.2 s: the force points everywhere, and its mean is not known."""
    rows = "".join(f"{0.01 * k},0,0,1,{0.1 * math.pi * k},0,0\n" for k in range(21))
    path = tmp_path / "path.csv"
    path.write_text("t_s,x_m,y_m,z_m,rx_rad,ry_rad,rz_rad\n" + rows)
    with pytest.warns(bristle.BristleWarning) as said:
        found = bristle.brush(motion=f"file:{path}", mount_angle_deg=0, elements=6, comm=ALONE)
    assert len(said) == len(found.warnings) == 2
    assert "because it varies; give" in found.warnings[0]
    assert "no bristle touches" in found.warnings[1]


def test_a_bristle_that_trails_is_the_elastica():
    """Clamp at 30 degrees, penetration 0.2 of the length, friction 0.5.

    Damping in proportion to mass brings it to rest, and drags at it: α ρA v L more force along the
    motion, which is 0.007 EI/L² and adds 0.2 % to the moment.
    """
    normal, moment = filament(math.radians(30.0), 0.5, 0.2)
    length, alpha_1_s, speed_m_s = paper.LENGTH_M, 5.0, 0.02
    stands = {"mount_angle_deg": 30.0, "penetration_m": 0.2 * length, "friction": 0.5}
    slides = {"motion": f"slide:speed={speed_m_s}", "start_s": 1.0, "until_s": 3.0, "every_s": 0.02}
    calm = {"gravity_m_s2": 0.0, "alpha_1_s": alpha_1_s}
    found = bristle.brush(**stands, **slides, **calm, comm=ALONE)
    late, tips = found.hub[found.hub.t_s > 2.0], found.tips[found.tips.t_s > 2.0]
    assert set(tips.state) == {"slip"}
    normal_N = tips.normal_N.mean()
    assert normal_N * length**2 / EI == pytest.approx(normal, rel=2e-3)
    assert late.my_Nm.mean() * length / EI == pytest.approx(moment, rel=4e-3)
    drag_N = alpha_1_s * WEIGHT_N / paper.GRAVITY_M_S2 * speed_m_s
    assert late.fx_N.mean() == pytest.approx(-0.5 * normal_N - drag_N, rel=2e-3)
    assert late.fz_N.mean() == pytest.approx(normal_N, rel=2e-3)
    for name, value in (
        ("brush-elastica", normal),
        ("brush-normal-N", normal * EI / length**2),
        ("brush-drag-N", drag_N),
    ):
        assert readme.agree(readme.number(name), value), name
    # stress of the root moment in the extreme fibre, a little more while the hub comes down
    stress = late.my_Nm.mean() * 0.5 * paper.THICKNESS_M * paper.YOUNGS_PA / EI
    assert stress < found.bending_stress.greatest_Pa < 1.2 * stress


def test_the_tutorial_prints_what_it_shows(tmp_path):
    (session,) = [each for each in readme.sessions() if each.words[1] == "brush"]
    assert readme.run(session, tmp_path) == []
    assert (tmp_path / "results" / "brush" / "report.html").is_file()


def test_bristles_that_bend_too_far_are_told(tmp_path):
    status, _, lines = run("brush", *FLAGS, "--yield-strength", "1e6", "--out", tmp_path)
    assert status == 0
    said = [line for line in lines if "would stay bent" in line]
    assert len(said) == 1
    assert said[0].startswith("bristle: warning: bristle 0 bends to")
    assert "Bristles would stay bent" in (tmp_path / "report.html").read_text()


def test_four_bristles_about_the_hubs_axis_carry_four_times_as_much():
    """They pass through each other. Their levers cancel, so that the torque is four times too."""
    inputs = {**SHORT, "start_s": 0.05, "until_s": 0.05, "every_s": 0.01}
    one = bristle.brush(**inputs, comm=ALONE)
    apart = {"layout": "row", "count": 4, "rows": 2, "touch_each_other": False}
    four = bristle.brush(**inputs, **apart, comm=ALONE)
    for name in HUB[1:]:
        expected, scale = 4.0 * one.hub[name], 4.0 * one.hub.fz_N.abs().max()
        np.testing.assert_allclose(four.hub[name], expected, rtol=1e-6, atol=1e-6 * scale)
    assert one.hub.fz_N.max() > WEIGHT_N


def test_flat_bristles_that_buckle_side_by_side_gain_no_energy():
    """They turn by more than 14.5 degrees between two nodes, so elements of two of them cross in
    the plane in which they bend."""
    stands = {"layout": "row", "count": 3, "rows": 3, "spacing_m": 6e-4, "mount_angle_deg": 0.0}
    pressed = {"penetration_m": 0.01, "start_s": 0.004, "until_s": 0.0023, "every_s": 1e-4}
    ends_early = pytest.warns(bristle.BristleWarning, match="; give until_s more than start_s")
    with pytest.warns(bristle.BristleWarning, match="would stay bent"), ends_early:
        found = bristle.brush(**stands, **pressed, write_fields=False, comm=ALONE)
    assert found.tips.between_N.max() > 0.0
    assert found.energy.closure_relative < 5e-3


def test_a_rough_surface_is_touched_where_it_is_highest_and_told(tmp_path):
    """Two bristles start at first touch, the hub higher than over the plane by what lies under
    them; the surface is in result.json, on the page and in ParaView's series."""
    stands = {"layout": "row", "count": 2, "spacing_m": 0.05}
    rough = {**stands, "rms_height_m": 1e-3, "surface_seed": 4}
    short = {"start_s": 0.002, "until_s": 0.002, "penetration_m": 1e-4}
    with pytest.warns(bristle.BristleWarning, match="the run ends before"):
        found = bristle.brush(**rough, **short, out=tmp_path, comm=ALONE)
    told = json.loads((tmp_path / "result.json").read_text())
    plane, inputs = brush(**stands), brush(**rough)
    raised = told["hub_at_first_touch_m"] - plane.first_touch_m
    patch = surface_of(inputs).patch(found.tips.x_m[:2].to_numpy(), found.tips.y_m[:2].to_numpy())
    assert abs(patch.heights_m).max() > 1e-4
    # within what the surface rises over half a wide side
    assert raised == pytest.approx(patch.heights_m.max(), abs=0.5 * paper.WIDTH_M)
    assert found.tips.normal_N.max() > 0.0
    assert told["surface"]["rms_height_m"] == pytest.approx(1e-3, rel=0.2)
    assert "fine aggregate" in (tmp_path / "report.html").read_text()
    points = pyvista.read(tmp_path / "fields" / "ground.vtu").points
    expected = surface_of(inputs).patch(points[:, 0], points[:, 1]).heights_m
    assert points[:, 2] == pytest.approx(expected, abs=1e-9)
    assert np.diff(np.unique(points[:, 0])).max() < 0.2 * told["surface"]["correlation_length_m"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"correlation_length_m": 1e-3}, "give rms_height_m"),
        ({"surface_seed": 2}, "is of a rough surface"),
        ({"surface": "wall.npz", "rms_height_m": 1e-4}, "no meaning with a measured surface"),
        ({"surface": "wall.npz"}, "wall.npz"),
        ({"surface": "nowhere.npz"}, "nowhere.npz: No such file"),
        ({"friction_between": 0.1}, "none does here"),
    ],
)
def test_what_changes_nothing_is_refused(given, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wall.npz").touch()
    with pytest.raises(bristle.InputError, match=said):
        bristle.brush(**given, comm=ALONE)


def test_each_corner_on_a_rigid_surface_is_stiffer_than_an_element(tmp_path):
    found = bristle.brush(**SHORT, kn_N_m=math.inf, out=tmp_path, comm=ALONE)
    assert found.inputs.kn_N_m == math.inf
    stiff = 2.5 * paper.YOUNGS_PA * paper.WIDTH_M * paper.THICKNESS_M / (paper.LENGTH_M / 6)
    assert brush(kn_N_m=math.inf).ground.kn_N_m == pytest.approx(4 * stiff)
    rough = brush(kn_N_m=math.inf, rms_height_m=1e-4).ground.rough
    assert np.all(rough.factor == 1.0)
    assert np.ptp(brush(rms_height_m=1e-4).ground.rough.factor) > 0.1
    assert json.loads((tmp_path / "result.json").read_text())["inputs"]["kn_N_m"] == "inf"


def test_ranks_change_nothing(tmp_path):
    arguments = ["-m", "bristle.studies.brush", "--layout", "ring", "--count", "5", *FLAGS]
    for ranks in (1, 2):
        done = mpirun(ranks, *arguments, "--out", tmp_path / str(ranks), timeout_s=300.0)
        assert done.returncode == 0, done.stderr
    for name in ("hub.csv", "tips.csv"):
        alone, together = (pd.read_csv(tmp_path / ranks / name) for ranks in "12")
        numbers = alone.select_dtypes(float).columns
        np.testing.assert_allclose(together[numbers], alone[numbers], rtol=1e-9, atol=1e-15)
    # sums over bristles do not depend on who marched them, which a run that goes on does not know
    alone, together = ((tmp_path / ranks / "means.csv").read_bytes() for ranks in "12")
    assert alone == together


# --- again and on ---------------------------------------------------------------------------------


def test_it_repeats_from_its_own_result(done, tmp_path):
    again = inputs_of(BrushInputs, {}, BRUSH_FLAGS, done / "result.json")
    assert again == brush(layout="row", count=3)
    longer = inputs_of(BrushInputs, {"until": 0.04}, BRUSH_FLAGS, done / "result.json")
    assert longer.every_s == 0.04 / 200  # follows from what is changed, unless it was given
    study.run_brush(again, tmp_path, ALONE)
    for name in ("hub.csv", "tips.csv"):
        assert (tmp_path / name).read_bytes() == (done / name).read_bytes()


def test_the_shortest_run_has_the_shortest_time_between_rows():
    assert checked(BrushInputs, {"until_s": 1e-6}).every_s == 1e-7
    assert checked(BrushInputs, {"until_s": 1.0}).every_s == 1.0 / 200


class Stopped(Exception):
    pass


def stopping(rods_march, after):
    """`Rods.march` that is stopped after some frames."""

    def march(self, *args):
        for number, frame in enumerate(rods_march(self, *args)):
            if number == after:
                raise Stopped
            yield frame

    return march


def test_what_was_interrupted_goes_on_to_the_bit(done, tmp_path, monkeypatch):
    inputs = brush(layout="row", count=3)
    march = Rods.march
    monkeypatch.setattr(Rods, "march", stopping(march, 6))
    with pytest.raises(Stopped):
        study.run_brush(inputs, tmp_path, ALONE, keep_s=0.0)
    assert {path.name for path in tmp_path.iterdir()} == {"checkpoint", MARK}
    monkeypatch.setattr(Rods, "march", stopping(march, 4))  # four more are all that is missing
    study.run_brush(inputs, tmp_path, ALONE, resume=True)
    for name in ("hub.csv", "tips.csv"):
        assert (tmp_path / name).read_bytes() == (done / name).read_bytes()
    frames = sorted(path.name for path in (done / "fields").iterdir())
    assert sorted(path.name for path in (tmp_path / "fields").iterdir()) == frames
    for name in frames:
        assert (tmp_path / "fields" / name).read_bytes() == (done / "fields" / name).read_bytes()
    assert not (tmp_path / "checkpoint").exists()
    before = (tmp_path / "result.json").read_bytes()
    monkeypatch.setattr(Rods, "march", stopping(march, 0))
    study.run_brush(inputs, tmp_path, ALONE, resume=True)  # nothing to do
    assert (tmp_path / "result.json").read_bytes() == before


def test_another_brush_is_not_resumed(done):
    arguments = ["--layout", "row", "--count", "3", *FLAGS, "--resume", "--out", done]
    says = refused("brush", *arguments, "--mount-angle", "25")
    assert "--mount-angle is 20.0 there, 25.0 is asked for" in says


def test_without_fields_an_earlier_series_goes(tmp_path):
    inputs = brush(elements=2, until_s=0.004)
    study.run_brush(inputs, tmp_path, ALONE)
    (tmp_path / "fields" / "mine.txt").write_text("kept\n")
    study.run_brush(brush(elements=2, until_s=0.004, write_fields=False), tmp_path, ALONE)
    assert [path.name for path in (tmp_path / "fields").iterdir()] == ["mine.txt"]


# --- wrong input ----------------------------------------------------------------------------------


HIGH = 0.32


@pytest.mark.parametrize(
    ("rows", "more", "says"),
    [
        ([(0, 0, 0, HIGH), (1e-3, 0.5, 0, HIGH)], [], "path.csv:3: the hub jumps: 500 m/s"),
        ([(0, 0, 0, HIGH), (1, 0, 0, -0.01)], [], "--motion: the path takes a clamp below"),
        ([(0, 0, 0, 0.2), (1, 0, 0, 0.2)], [], "--motion: a bristle starts 0.116 m below"),
        ([(0, 0, 0, HIGH), (1, 0, 0, HIGH)], ["--until", "2"], "--until: 2 s is after the path's"),
        ([(0, 0, 0, HIGH), (1, 0, 0, HIGH)], ["--penetration", "0.01"], "--penetration: is in the"),
        ([(0, 0, 0, HIGH), (1, 0, 0, HIGH)], ["--start", "0.2"], "--start: is in the times of"),
    ],
    ids=str,
)
def test_a_path_that_cannot_be_ends_with_2(rows, more, says, tmp_path):
    path = path_file(tmp_path, rows)
    out = tmp_path / "out"
    assert says in refused("brush", "--motion", f"file:{path}", *more, "--out", out)
    assert not out.exists()


def test_a_measured_surface_that_has_changed_since_is_not_gone_on_with(tmp_path):
    """A result holds the digest of what it was computed on."""
    path, out = tmp_path / "wall.txt", tmp_path / "out"
    heights = 1e-4 * np.random.default_rng(1).standard_normal((20, 20))
    np.savetxt(path, heights, header="spacing_m = 1e-4")
    arguments = ("brush", "--surface", path, "--until", "0.001", "--out", out)
    assert run(*arguments)[0] == 0
    kept = json.loads((out / "result.json").read_text())["inputs"]["surface"]
    assert kept["path"] == str(path)
    np.savetxt(path, 2.0 * heights, header="spacing_m = 1e-4")
    assert "--surface is" in refused(*arguments, "--resume")
    assert "has changed since" in refused("brush", "--config", out / "result.json")


def test_a_path_counts_from_the_folder_of_its_configuration(tmp_path, monkeypatch):
    path = path_file(tmp_path, [(0, 0, 0, HIGH), (0.5, 0, 0, HIGH)])
    (tmp_path / "brush.toml").write_text('motion = "file:path.csv"\n')
    monkeypatch.chdir("/")
    found = inputs_of(BrushInputs, {}, BRUSH_FLAGS, tmp_path / "brush.toml")
    assert found.motion.file.path == str(path.resolve())
    assert found.until_s == 0.5
    assert str(found.motion) == f"file:{path.resolve()}"
    # a result names the file with its digest, and a file that has changed since is refused
    document = {"inputs": json.loads(found.model_dump_json())}
    (tmp_path / "result.json").write_text(json.dumps(document))
    assert inputs_of(BrushInputs, {}, BRUSH_FLAGS, tmp_path / "result.json") == found
    path_file(tmp_path, [(0, 0, 0, HIGH), (0.7, 0, 0, HIGH)])
    with pytest.raises(bristle.InputError, match="has changed since that run"):
        inputs_of(BrushInputs, {}, BRUSH_FLAGS, tmp_path / "result.json")
    anew = {"motion": "slide:speed=1"}
    slid = inputs_of(BrushInputs, anew, BRUSH_FLAGS, tmp_path / "result.json")
    assert (slid.penetration_m, slid.until_s) == (0.02, 1.0)


def test_elements_that_turn_too_far_are_told_to_be_too_few(tmp_path):
    """Pressed at 7 m/s, neighbouring nodes of four elements turn by half a turn."""
    few = ["--elements", "4", "--start", "0.005", "--until", "0.01", "--no-fields"]
    status, _, lines = run("brush", *few, "--out", tmp_path)
    assert status == 1
    assert "bristle 0 does not converge" in lines[-1]
    assert "try more elements" in lines[-1]


def test_upright_bristles_that_are_pressed_alone_are_warned_of():
    upright = {"mount_angle_deg": 0.0, "motion": "press"}
    assert "buckle" in study._buckling_warnings(brush(**upright))[0]
    for change in ({"mount_angle_deg": 5.0}, {"motion": "slide:speed=1"}, {"angle_std_deg": 1.0}):
        assert study._buckling_warnings(brush(**{**upright, **change})) == []


def test_the_first_touch_is_where_the_lowest_corner_meets_the_surface():
    inputs = brush(mount_angle_deg=30.0)
    c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    expected = paper.LENGTH_M * c + 0.5 * paper.THICKNESS_M * s
    assert inputs.first_touch_m == pytest.approx(expected, rel=1e-12)
    assert inputs.hub_motion.pose(0.0).position_m[2] == pytest.approx(expected, rel=1e-12)
